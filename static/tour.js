// Four hints on the demo for who sees the page for the first time, one beside each tab.
(() => {
  const { photoreg } = window;
  const SEEN = "photoreg-tour"; // In the browser's own store: "seen" once it was ended.
  const HINTS = [
    ["1 Data", "A scan and two photos of it",
      "This demo shows the whole way. For your own, drop a scan and photos anywhere on this page."],
    ["2 Align", "Bring each photo roughly into place",
      "Look through it and move the camera, or click the same points in photo and model: Points, at the left. In the demo that is done."],
    ["4 Export", "Take it along",
      "Make one texture of all photos, and download the model and the cameras."],
    ["3 Refine", "Now let it be laid on exactly",
      "Press Refine and watch. At the end it says how far the answer is to be believed."],
  ];
  const style = document.createElement("style");
  style.textContent = `
  .pr-tour{position:fixed;z-index:90;width:min(290px,calc(100vw - 20px));padding:12px 14px;
    border-radius:10px;background:#10403b;color:#fff;font:14px/1.4 inherit;
    font-family:inherit;box-shadow:0 6px 30px rgba(0,0,0,.45)}
  .pr-tour::before{content:"";position:absolute;top:-7px;left:var(--at);width:14px;height:14px;
    background:inherit;transform:rotate(45deg);border-radius:3px 0 0 0}
  .pr-tour b{display:block;margin-bottom:3px}
  .pr-tour div{display:flex;gap:8px;align-items:center;margin-top:10px;font-size:13px}
  .pr-tour button{font:inherit;border:0;border-radius:6px;padding:5px 12px;cursor:pointer;
    background:rgba(255,255,255,.16);color:#fff}
  .pr-tour button[data-next]{background:#2dd4bf;color:#04211e;font-weight:600}`;
  document.head.append(style);

  let card = null;
  let step = 0;
  const place = () => {
    const box = card && photoreg.tab(HINTS[step][0])?.getBoundingClientRect();
    if (!box) return;
    const left = Math.max(10, Math.min(box.left - 20, innerWidth - card.offsetWidth - 10));
    card.style.left = `${left}px`;
    card.style.top = `${box.bottom + 12}px`;
    card.style.setProperty("--at", `${box.left + box.width / 2 - left - 7}px`);
  };
  const end = () => {
    try {
      localStorage.setItem(SEEN, "seen");
    } catch {
      // Who lets pages keep nothing gets the hints each time.
    }
    card?.remove();
    card = null;
    removeEventListener("resize", place);
    removeEventListener("keydown", onKey, true);
  };
  const onKey = (event) => {
    if (event.key !== "Escape") return;
    event.stopPropagation();
    end();
  };
  const show = () => {
    const [name, title, text] = HINTS[step];
    photoreg.open(name);
    const last = step === HINTS.length - 1;
    card.setAttribute("aria-label", `Hint ${step + 1} of ${HINTS.length}: ${title}`);
    card.innerHTML =
      `<b>${title}</b>${text}<div><span style="flex:1;opacity:.8">${step + 1} of ` +
      `${HINTS.length}</span>` +
      (last ? "" : '<button title="No more hints; Help has them again">Skip</button>') +
      `<button data-next title="${last ? "Ends the hints" : "The next hint"}">` +
      `${last ? "Got it" : "Next"}</button></div>`;
    place();
    card.querySelector("[data-next]").focus({ preventScroll: true });
  };
  const wasSeen = () => {
    try {
      return localStorage.getItem(SEEN) === "seen";
    } catch {
      return false;
    }
  };
  const begin = () => {
    if (card || !photoreg.tab("1 Data")) return;
    step = 0;
    card = document.createElement("div");
    card.className = "pr-tour";
    card.setAttribute("role", "dialog");
    card.addEventListener("click", ({ target }) => {
      if (target.tagName !== "BUTTON") return;
      if (!("next" in target.dataset) || step === HINTS.length - 1) return end();
      step += 1;
      show();
    });
    document.body.append(card);
    addEventListener("resize", place);
    addEventListener("keydown", onKey, true);
    show();
  };
  // It opens by itself once on the demo, and again whenever the help asks for it.
  photoreg.define("tour", ({ dataset }) => {
    if (dataset.again || !wasSeen()) setTimeout(begin, 300);
  });
})();
