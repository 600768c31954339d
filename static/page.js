// What viser's page lacks, for all panels of the app: a way to tell the server what was
// done in HTML, and files dropped anywhere. No request leaves the app's own server.
// HTML of the panels has no script in it: what it is and does stands in data attributes.
(() => {
  const photoreg = (window.photoreg ??= {});
  const kinds = (photoreg.kinds ??= {});
  let count = 0;

  // Tells the server; `act` says which handler of app/web/bridge.py gets it.
  photoreg.send = (act, values = {}) => {
    const message = JSON.stringify({ act, ...values, count: ++count, at: Date.now() });
    window.__viserMutable.sendMessage({
      type: "GuiUpdateMessage",
      uuid: photoreg.bridge,
      updates: { value: message },
    });
  };

  // Calls `kind(element)` for every <span data-kind=name> that is there or appears.
  photoreg.define = (name, kind) => {
    kinds[name] = kind;
    document.querySelectorAll(`[data-kind="${name}"]`).forEach(kind);
  };
  new MutationObserver((changes) => {
    for (const change of changes)
      for (const node of change.addedNodes) {
        if (!node.isConnected || node.nodeType !== Node.ELEMENT_NODE) continue;
        for (const element of [node, ...node.querySelectorAll("[data-kind]")])
          kinds[element.dataset.kind]?.(element);
      }
  }).observe(document, { childList: true, subtree: true });

  const input = () => document.getElementById(`file_upload_${photoreg.upload}`);
  photoreg.define("boot", ({ dataset }) => {
    photoreg.bridge = dataset.bridge;
    photoreg.upload = dataset.upload;
    photoreg.maxBytes = Number(dataset.bytes);
    // The input must exist to take files, and need not be seen.
    const hide = () => {
      const box = input()?.parentElement;
      if (!box) setTimeout(hide, 50);
      else if (box.querySelectorAll("button").length === 1) box.style.display = "none";
    };
    hide();
  });

  // What a click does; of elements within each other only the innermost counts.
  document.addEventListener("click", (event) => {
    const element = event.target.closest(
      "[data-send],[data-hold],[data-choose],[data-rename],[data-open]",
    );
    if (!element) return;
    const { send, hold, choose, open, mode } = element.dataset;
    if (send) photoreg.send(...JSON.parse(send));
    else if (open) {
      photoreg.open(open);
      if (mode) photoreg.picker.setMode(mode);
    }
    // A click without a press is the keyboard's.
    else if (hold) event.detail || photoreg.send(...JSON.parse(hold));
    else if (choose !== undefined) photoreg.choose(choose);
    else {
      const card = element.closest("[data-photo]");
      photoreg.rename(card.querySelector(".pr-name"), card.dataset.photo);
    }
  });
  document.addEventListener("pointerdown", (event) => {
    const button = event.target.closest("[data-hold]");
    if (button) photoreg.hold(event, ...JSON.parse(button.dataset.hold));
  });

  // Typing a new name in place of the old one; Enter takes it, Escape leaves it.
  photoreg.rename = (label, photo) => {
    const box = document.createElement("input");
    box.value = photo;
    box.setAttribute("aria-label", "New name");
    box.style.cssText =
      "font:inherit;width:100%;color:inherit;background:rgba(128,140,155,.2);" +
      "border:1px solid #2dbeaf;border-radius:4px;padding:1px 4px;outline:none";
    let done = false;
    const end = (take) => {
      if (done) return;
      done = true;
      const name = box.value.trim();
      label.textContent = label.dataset.shown;
      if (take && name !== photo) photoreg.send("rename", { photo, name });
    };
    label.dataset.shown ??= label.textContent;
    box.addEventListener("keydown", (e) => {
      e.stopPropagation();
      if (e.key === "Enter") end(true);
      if (e.key === "Escape") end(false);
    });
    box.addEventListener("click", (e) => e.stopPropagation());
    box.addEventListener("blur", () => end(true));
    label.replaceChildren(box);
    box.focus();
    box.select();
  };

  // viser's greys, and in its light theme its teal and red, are too faint to read.
  // In narrow panels its scrollbar would lie on the inputs, and the arrows of three numbers
  // in a row on their digits: the keyboard's arrows do the same. Three have a row of their
  // own, below their label: coordinates of surveys are long.
  // Where the system asks for less motion, only what a person lets blink moves by itself.
  // viser's folds wait for the end of their motion before they are closed: it is made brief.
  const first = ".mantine-NumberInput-root:first-child:nth-last-child(3)";
  const triple = `:is(${first}, ${first} ~ .mantine-NumberInput-root)`;
  const style = document.createElement("style");
  style.textContent = `
  .mantine-Notification-description{color:inherit}
  .mantine-ScrollArea-root{--scrollarea-scrollbar-size:6px!important}
  .mantine-Flex-root:has(>:first-child>p>label):has(${first}){flex-wrap:wrap}
  .mantine-Flex-root:has(>:first-child>p>label):has(${first})>*{width:100%!important}
  ${triple} .mantine-NumberInput-section{display:none}
  ${triple} input{padding-inline:.35em!important}
  .mantine-Modal-content:has(.pr-keys){--modal-size:46rem}
  :root:root[data-mantine-color-scheme=dark]{--mantine-color-dimmed:#a3a3a3}
  :root:root[data-mantine-color-scheme=light]{--mantine-color-dimmed:#5c656d;
    --mantine-color-gray-filled:#495057;--mantine-color-gray-filled-hover:#343a40;
    --mantine-color-red-filled:#d42a2a;--mantine-color-red-filled-hover:#b82323;
    --mantine-primary-color-filled:#14857a}
  :root[data-mantine-color-scheme=light] .mantine-Button-root{
    --mantine-primary-color-filled:#26a69a;--mantine-primary-color-filled-hover:#1d9e90}
  @media (prefers-reduced-motion:reduce){
    :not(.before,[style*=transition]),::before,::after{
      animation:none!important;transition:none!important}
    [style*=transition]{transition-duration:.01ms!important;transition-delay:0s!important}}`;
  document.head.append(style);

  // viser's buttons do not show their hints: each has it as its title once it appears.
  let hints = {};
  const showHints = () => {
    for (const [id, hint] of Object.entries(hints)) {
      const button = document.getElementById(id);
      if (button && button.title !== hint) button.title = hint;
    }
  };
  photoreg.define("hints", (element) => {
    hints = JSON.parse(element.dataset.hints);
    showHints();
  });
  new MutationObserver(showHints).observe(document.body, { childList: true, subtree: true });

  // Files: each goes through viser's hidden upload input, one after the other.
  let sending = null; // the name of the file on its way
  const later = (ms) => new Promise((ok) => setTimeout(ok, ms));

  // Files that come while others are still on their way wait for these.
  let before = Promise.resolve();
  photoreg.files = (files) => {
    const batch = [...files];
    if (batch.length) before = before.then(() => send(batch)).catch(console.error);
  };

  const send = async (files) => {
    photoreg.send("batch", { files: files.length });
    try {
      for (const file of files) {
        // Half a character in a name cannot be sent.
        const name = file.name.toWellFormed?.() ?? file.name;
        const transfer = new DataTransfer();
        transfer.items.add(name === file.name ? file : new File([file], name));
        const box = input();
        box.files = transfer.files;
        sending = name;
        box.dispatchEvent(new Event("change", { bubbles: true }));
        while (sending !== null) await later(30);
      }
    } finally {
      sending = null;
    }
  };

  photoreg.define("uploaded", (element) => {
    if (element.dataset.file === sending) sending = null;
  });

  // What is too large is not sent: for every input, before viser sees it.
  window.addEventListener(
    "change",
    (event) => {
      const box = event.target;
      const file = box.id?.startsWith?.("file_upload_") ? box.files?.[0] : undefined;
      if (!file || !(file.size > photoreg.maxBytes)) return;
      event.stopImmediatePropagation();
      photoreg.send("oversized", { name: file.name, size: file.size });
      if (file.name === sending) sending = null;
    },
    true,
  );

  photoreg.choose = (accept = "") => {
    const box = document.createElement("input");
    box.type = "file";
    box.accept = accept;
    box.multiple = true;
    box.id = "photoreg-files";
    box.style.display = "none";
    document.getElementById(box.id)?.remove();
    box.addEventListener("change", () => photoreg.files(box.files));
    document.body.append(box);
    box.click();
  };

  const target = document.createElement("div");
  target.id = "photoreg-drop";
  target.innerHTML =
    '<div style="border:2.5px dashed #2dbeaf;border-radius:18px;padding:44px 64px;' +
    'text-align:center;background:rgba(16,22,28,.82)">' +
    '<div style="font-size:24px;font-weight:650;margin-bottom:8px">Drop to open</div>' +
    '<div style="font-size:15px;opacity:.8">A mesh, photos, cameras, several at once' +
    "</div></div>";
  target.style.cssText =
    "position:fixed;inset:0;z-index:9999;display:none;align-items:center;" +
    "justify-content:center;background:rgba(10,14,18,.55);color:#fff;" +
    "font-family:inherit;pointer-events:none;backdrop-filter:blur(2px)";
  document.body.append(target);
  const holdsFiles = (e) => [...(e.dataTransfer?.types ?? [])].includes("Files");
  let depth = 0;
  const show = (on) => (target.style.display = on ? "flex" : "none");
  window.addEventListener("dragenter", (e) => {
    if (!holdsFiles(e)) return;
    e.preventDefault();
    depth += 1;
    show(true);
  });
  window.addEventListener("dragover", (e) => holdsFiles(e) && e.preventDefault());
  window.addEventListener("dragleave", (e) => {
    if (!holdsFiles(e)) return;
    depth = Math.max(0, depth - 1);
    if (!depth) show(false);
  });
  window.addEventListener("drop", (e) => {
    if (!holdsFiles(e)) return;
    e.preventDefault();
    depth = 0;
    show(false);
    photoreg.files(e.dataTransfer.files);
  });
})();
