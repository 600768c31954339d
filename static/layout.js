// How the page keeps its shape: what is always to be seen stays while a panel scrolls,
// panels make room on narrow screens, and questions are answered by keyboard and mouse as
// everywhere. viser does none of these.
(() => {
  const { photoreg } = window;

  // The rows marked as head, and the tabs below them, stay at the top of their panel.
  const style = document.createElement("style");
  style.textContent = `
  .pr-stays{position:sticky;z-index:3;display:flow-root;
    background-color:var(--mantine-color-body)}
  .pr-first{box-shadow:0 -12px var(--mantine-color-body)}`;
  document.head.append(style);
  let staying = [];
  const stack = () => {
    const content = staying[0]?.closest(".mantine-ScrollArea-content");
    if (!content) return;
    // Each stays where it is by itself while nothing is scrolled.
    const top = (element) => element.getBoundingClientRect().top;
    for (const row of staying) row.style.position = "static";
    const tops = staying.map((row) => top(row) - top(content));
    staying.forEach((row, i) => {
      row.style.position = "";
      row.style.top = `${tops[i]}px`;
    });
  };
  const sizes = new ResizeObserver(stack);
  photoreg.define("head", (element) => {
    const content = element.closest(".mantine-ScrollArea-content");
    const list = element.parentElement?.parentElement;
    if (!content || !list) return;
    const rows = [...list.children].filter((row) => row.querySelector("[data-kind=head]"));
    const tabs = rows.at(-1)?.nextElementSibling?.querySelector("[role=tablist]");
    staying.forEach((row) => row.classList.remove("pr-stays", "pr-first"));
    sizes.disconnect();
    staying = tabs ? [...rows, tabs] : rows;
    for (const row of staying) {
      row.classList.add("pr-stays");
      sizes.observe(row);
    }
    rows[0].classList.add("pr-first");
    // What clips what is beyond it would hold the rows; this clips the same.
    for (let box = tabs?.parentElement ?? list; box !== content; box = box.parentElement)
      if (getComputedStyle(box).overflow === "hidden") box.style.overflow = "clip";
    stack();
  });

  // Below WIDE the panel at the left folds, below NARROW panels lie over the scene. Said to
  // viser as its server would, in a run of our own: what somebody moves meanwhile stays.
  const WIDE = 1100;
  const NARROW = 900;
  let count = 0;
  const place = (type, uuid, values) => {
    window.__viserMutable.messageQueue.push({
      type: `GuiSetPanel${type}Message`,
      uuid,
      ...values,
      counter: ++count,
      run_id: "photoreg-layout",
    });
    window.__viserMutable.requestRender();
  };
  let panels = null;
  let were = "wide";
  const wide = window.matchMedia(`(min-width: ${WIDE}px)`);
  const narrow = window.matchMedia(`(max-width: ${NARROW - 0.02}px)`);
  const arrange = () => {
    const now = wide.matches ? "wide" : narrow.matches ? "narrow" : "middle";
    if (!panels || !window.__viserMutable || now === were) return;
    const { left, main } = panels;
    if (now === "narrow") {
      place("Position", main, { position: { kind: "float", x: -8, y: 8 } });
      place("Position", left, { position: { kind: "float", x: 8, y: 8 } });
    } else if (were === "narrow") {
      place("Position", main, { position: { kind: "edge", edge: "right" } });
      place("Position", left, { position: { kind: "edge", edge: "left" } });
      place("Width", main, { width: Number(panels.mainWidth) });
      place("Width", left, { width: Number(panels.leftWidth) });
    }
    if (now === "wide" || were === "wide" || now === "narrow")
      place("Collapsed", left, { collapsed: now !== "wide" });
    were = now;
  };
  photoreg.define("panels", ({ dataset }) => {
    panels = { ...dataset };
    arrange();
  });
  for (const query of [wide, narrow]) query.addEventListener("change", arrange);

  // Opens a tab; a folded panel unfolds for it.
  photoreg.tab = (name) =>
    [...document.querySelectorAll("[role=tab]")].find((t) => t.textContent.trim() === name);
  photoreg.open = (name) => {
    // viser's tabs are opened by a press or by this key.
    const press = new KeyboardEvent("keydown", { key: "Enter", bubbles: true });
    photoreg.tab(name)?.dispatchEvent(press);
  };

  // The button for viser's own page shows the page's settings; that page, of the connection
  // and the scene's nodes, which helps to find faults, is opened from there.
  const SETTINGS = "Demo and page";
  const COG = "button:has(.tabler-icon-adjustments)";
  let isAsked = false;
  const showSettings = (tries = 40) => {
    photoreg.open("1 Data");
    const fold = [...document.querySelectorAll(".mantine-Paper-root[aria-expanded]")].find(
      (one) => one.textContent.startsWith(SETTINGS) && one.offsetParent,
    );
    if (!fold) return tries > 0 && setTimeout(showSettings, 50, tries - 1);
    if (fold.ariaExpanded === "false") fold.click();
    fold.focus();
    const box = fold.parentElement;
    new ResizeObserver((_, sizes) => {
      box.scrollIntoView({ block: "end" });
      setTimeout(() => sizes.disconnect(), 500);
    }).observe(box);
  };
  document.addEventListener(
    "click",
    (event) => {
      if (event.target.closest?.("[data-diagnose]")) {
        isAsked = true;
        document.querySelector(COG)?.click();
        isAsked = false;
      } else if (!isAsked && event.target.closest?.(COG)) {
        event.stopPropagation();
        showSettings();
      }
    },
    true,
  );

  // Tells the server while a tab is on screen, however far it is scrolled.
  const open = new Map();
  const sight = new IntersectionObserver((entries) => {
    for (const { target, isIntersecting } of entries) {
      const act = open.get(target);
      if (act.on !== isIntersecting) photoreg.send(act.name, { on: (act.on = isIntersecting) });
    }
  });
  photoreg.define("sight", (element) => {
    const tab = element.closest(".mantine-ScrollArea-content");
    if (!tab || open.has(tab)) return;
    open.set(tab, { name: element.dataset.act, on: false });
    sight.observe(tab);
  });

  // Names for screen readers, and the keyboard for folds, which viser leaves out.
  const ICONS = {
    "tabler-icon-list-search": "All commands (Ctrl+K)",
    "tabler-icon-adjustments": "Settings of the page",
    "tabler-icon-arrow-back": "Back to the panels",
  };
  const name = (element, text) => {
    if (!element.getAttribute("aria-label")) element.setAttribute("aria-label", text);
  };
  const nameAll = () => {
    for (const label of document.querySelectorAll("label[for]")) {
      const row = label.parentElement?.parentElement?.parentElement;
      const fields = row?.querySelectorAll("input:not([type=hidden]),textarea,[role=slider]") ?? [];
      for (const field of fields) if (field.id !== label.htmlFor) name(field, label.textContent);
    }
    for (const [icon, text] of Object.entries(ICONS)) {
      const button = document.querySelector(`button:has(.${icon})`);
      if (!button) continue;
      // One button has either icon, by turns.
      button.setAttribute("aria-label", text);
      button.title = text;
    }
    for (const picture of document.querySelectorAll("img:not([alt])"))
      picture.alt = "The photos laid over each other";
    const folds = ".mantine-Paper-root:has(>.tabler-icon-chevron-down,>.tabler-icon-chevron-up)";
    for (const fold of document.querySelectorAll(folds)) {
      fold.setAttribute("role", "button");
      fold.tabIndex = 0;
      const closed = fold.querySelector(".tabler-icon-chevron-down") !== null;
      fold.setAttribute("aria-expanded", String(!closed));
    }
  };
  let naming = null;
  new MutationObserver(() => {
    naming ??= setTimeout(() => {
      naming = null;
      nameAll();
    }, 150);
  }).observe(document.body, { childList: true, subtree: true });
  document.addEventListener("keydown", (event) => {
    const fold = event.target.closest?.(".mantine-Paper-root[aria-expanded]");
    if (fold !== event.target || (event.key !== "Enter" && event.key !== " ")) return;
    event.preventDefault();
    fold.click();
  });

  // Questions: Escape and a click beside them leave them, Enter in a field says yes. The
  // button that leaves is the last, the one that says yes is before it.
  const question = () => [...document.querySelectorAll(".mantine-Modal-content")].at(-1);
  const buttons = () => [...(question()?.querySelectorAll("button.mantine-Button-root") ?? [])];
  document.addEventListener(
    "keydown",
    (event) => {
      if (!question() || event.isComposing) return;
      if (event.key === "Escape") buttons().at(-1)?.click();
      else if (event.key === "Enter" && event.target.matches?.("input:not([type=checkbox])"))
        buttons().at(-2)?.click();
      else return;
      event.preventDefault();
      event.stopPropagation();
    },
    true,
  );
  document.addEventListener("pointerdown", ({ target }) => {
    const beside = target.closest?.(".mantine-Modal-inner,.mantine-Modal-overlay");
    if (beside && !target.closest(".mantine-Modal-content")) buttons().at(-1)?.click();
  });
})();
