// The photo picker: zoom, pan, numbered markers, a brush for the mask, and a box around
// the object.
// Photo pixels: (0, 0) is the centre of the first pixel, as everywhere in photoreg.
(() => {
  const { photoreg } = window;
  const TILE = 512;
  const CROP_PX = 76; // Of the other photo about a point, at the pixels of its overview.
  const CLICK_PX = 4; // A press that moves less is a click.
  const style = document.createElement("style");
  // The foot keeps its height whatever it says, and a button its width when it is pressed:
  // else the photo would move under the hand.
  style.textContent = `
  .pr-picker{position:relative;display:flex;flex-direction:column;gap:6px;font-size:12px;
    user-select:none;--edge:rgba(128,140,155,.3)}
  .pr-view{position:relative;overflow:hidden;border-radius:8px;background:#15181d;
    height:clamp(220px,38vh,460px);cursor:crosshair;touch-action:none;outline:none}
  .pr-view canvas{position:absolute;inset:0;width:100%;height:100%}
  .pr-bar{display:flex;gap:4px;align-items:center;flex-wrap:wrap}
  .pr-bar button{font:inherit;color:inherit;background:rgba(128,140,155,.16);border:0;
    border-radius:5px;padding:4px 6px;cursor:pointer;line-height:1.25}
  .pr-bar button:hover{background:rgba(128,140,155,.32)}
  .pr-bar button[aria-pressed=true]{background:#26a69a;color:#04211e}
  .pr-bar input{flex:1 1 60px;min-width:50px;accent-color:#1d9e90}
  .pr-bar.pr-foot{flex-wrap:nowrap;align-items:flex-start;line-height:1.35;min-height:2.7em}
  .pr-hint{flex:1;opacity:.75}
  .pr-info{flex:none;min-width:13ch;text-align:right;opacity:.65;font-variant-numeric:tabular-nums}
  .pr-mark{position:absolute;width:0;height:0;z-index:2;cursor:grab;outline:none}
  .pr-mark::before,.pr-mark::after{content:"";position:absolute;background:var(--c)}
  .pr-mark::before{left:-9px;top:-.75px;width:18px;height:1.5px;
    clip-path:polygon(0 0,33% 0,33% 100%,67% 100%,67% 0,100% 0,100% 100%,0 100%)}
  .pr-mark::after{left:-.75px;top:-9px;width:1.5px;height:18px;
    clip-path:polygon(0 0,100% 0,100% 33%,0 33%,0 67%,100% 67%,100% 100%,0 100%)}
  .pr-mark i{position:absolute;left:-9px;top:-9px;width:18px;height:18px;
    border-radius:50%;box-shadow:0 0 0 1px rgba(0,0,0,.55)}
  .pr-mark b{position:absolute;left:7px;top:-19px;min-width:17px;padding:0 4px;
    height:16px;line-height:16px;border-radius:8px;background:var(--c);color:#08110f;
    font-size:11px;text-align:center;font-weight:700}
  .pr-mark:focus-visible i,.pr-mark.pr-chosen i{box-shadow:0 0 0 2px #fff}
  .pr-crops:empty{display:none}
  .pr-crops canvas{width:${CROP_PX}px;height:${CROP_PX}px;border-radius:6px;background:#15181d}
  .pr-empty{position:absolute;inset:0;display:flex;align-items:center;
    justify-content:center;color:#98a2b3;text-align:center;padding:20px}
  .pr-large{position:fixed!important;left:10px;top:10px;z-index:400;width:52vw;
    height:calc(100vh - 20px);padding:10px;border-radius:12px;
    background:var(--mantine-color-body,#1f2329);box-shadow:0 8px 40px rgba(0,0,0,.5)}
  .pr-large .pr-view{height:auto;flex:1}`;
  document.head.append(style);

  const root = document.createElement("div");
  root.className = "pr-picker";
  root.innerHTML = `
    <div class="pr-bar">
      <button data-mode="points" aria-pressed="true" title="Click places a point">Points</button>
      <button data-mode="out" aria-pressed="false" title="Paint what shall not count">Mask</button>
      <button data-mode="in" aria-pressed="false" title="Paint back what shall count">Bring back</button>
      <button data-mode="box" aria-pressed="false" title="Drag a box around the object, for finding the camera">Box</button>
      <span style="flex:1"></span>
      <button data-do="fit" title="The whole photo">Fit</button>
      <button data-do="less" aria-label="Zoom out" title="Zoom out">−</button>
      <button data-do="more" aria-label="Zoom in" title="Zoom in">+</button>
      <button data-do="large" title="Large, beside the model">⤢</button>
    </div>
    <div class="pr-bar pr-brush" style="display:none">Brush
      <input type="range" min="0" max="100" value="55" aria-label="Brush size" title="How wide the brush paints">
      <button data-do="clear" title="The whole photo counts again">Clear mask</button>
    </div>
    <div class="pr-bar pr-boxed" style="display:none">
      <button data-do="unbox" title="The camera is found without it">Remove the box</button>
    </div>
    <div class="pr-view" tabindex="0"><canvas></canvas><div class="pr-marks"></div>
      <div class="pr-empty">Add a photo in the Data tab.</div></div>
    <div class="pr-bar pr-crops"></div>
    <div class="pr-bar pr-foot"><span class="pr-hint"></span>
      <span class="pr-info"></span></div>`;
  const find = (selector) => root.querySelector(selector);
  const view = find(".pr-view");
  const canvas = find("canvas");
  const marks = find(".pr-marks");
  const info = find(".pr-info");
  const hint = find(".pr-hint");
  const brush = find("input");
  const draw2d = canvas.getContext("2d");

  let state = { photo: null, pairs: [] };
  let mode = "points";
  let scale = 1; // css pixels a photo pixel
  let left = 0; // of the photo's left edge, in css pixels
  let top = 0;
  let fitted = null; // of which photo the view was fitted
  const images = new Map();
  let mask = null; // canvas of the overview's size: red where left out
  let maskShown = null;
  let stroke = null;
  let corners = null; // of the box that is being dragged: two places in the photo
  let cursor = null;
  let drag = null; // the marker on its way: { number, u, v }

  const toView = (u, v) => [left + (u + 0.5) * scale, top + (v + 0.5) * scale];
  const toPhoto = (x, y) => [(x - left) / scale - 0.5, (y - top) / scale - 0.5];
  const place = (e) => {
    const box = view.getBoundingClientRect();
    return [e.clientX - box.left, e.clientY - box.top];
  };
  const inside = ([u, v]) =>
    u >= -0.5 && v >= -0.5 && u <= state.width - 0.5 && v <= state.height - 0.5;
  const isBrush = () => mode === "out" || mode === "in";
  // From its corner, as the edge of the first pixel, not its centre.
  const boxOf = ([[u0, v0], [u1, v1]]) => {
    const clip = (value, size) => Math.min(Math.max(value + 0.5, 0), size);
    const [left, right] = [u0, u1].map((u) => clip(u, state.width)).sort((a, b) => a - b);
    const [top, bottom] = [v0, v1].map((v) => clip(v, state.height)).sort((a, b) => a - b);
    return [left, top, right - left, bottom - top];
  };
  const radius = () =>
    (0.002 * Math.pow(100, brush.value / 100) * Math.max(state.width, state.height)) / 2;

  function image(url) {
    let it = images.get(url);
    if (!it) {
      it = new Image();
      it.onload = draw;
      it.src = url;
      images.set(url, it);
      if (images.size > 120) images.delete(images.keys().next().value);
    }
    return it.complete && it.naturalWidth ? it : null;
  }

  function fit() {
    const { clientWidth: w, clientHeight: h } = view;
    if (!state.photo || !w || !h) return;
    scale = Math.min(w / state.width, h / state.height);
    left = (w - scale * state.width) / 2;
    top = (h - scale * state.height) / 2;
    fitted = state.photo;
    draw();
  }

  function zoom(factor, x = view.clientWidth / 2, y = view.clientHeight / 2) {
    const least = 0.5 * Math.min(view.clientWidth / state.width, view.clientHeight / state.height);
    const next = Math.min(64, Math.max(least, scale * factor));
    left = x - ((x - left) / scale) * next;
    top = y - ((y - top) / scale) * next;
    scale = next;
    draw();
  }

  let pending = false;
  function draw() {
    if (!pending) {
      pending = true;
      requestAnimationFrame(() => {
        pending = false;
        paint();
      });
    }
  }

  function paint() {
    const ratio = window.devicePixelRatio || 1;
    const { clientWidth: w, clientHeight: h } = view;
    if (canvas.width !== Math.round(w * ratio) || canvas.height !== Math.round(h * ratio)) {
      canvas.width = Math.round(w * ratio);
      canvas.height = Math.round(h * ratio);
    }
    draw2d.setTransform(ratio, 0, 0, ratio, 0, 0);
    draw2d.clearRect(0, 0, w, h);
    find(".pr-empty").style.display = state.photo ? "none" : "";
    if (!state.photo) return marks.replaceChildren();
    if (fitted !== state.photo) return fit();
    draw2d.imageSmoothingEnabled = scale * ratio < 4;
    const base = `/photoreg/photo/${state.photo}`;
    const whole = image(`${base}/overview.jpg`);
    draw2d.filter = brightening();
    if (whole) draw2d.drawImage(whole, left, top, scale * state.width, scale * state.height);
    if (whole && whole.naturalWidth < state.width && scale * ratio * state.width > 1.1 * whole.naturalWidth) {
      const [u0, v0] = toPhoto(0, 0);
      const [u1, v1] = toPhoto(w, h);
      const last = (n) => Math.ceil(n / TILE) - 1;
      for (let i = Math.max(0, Math.floor(u0 / TILE)); i <= Math.min(last(state.width), Math.floor(u1 / TILE)); i++)
        for (let j = Math.max(0, Math.floor(v0 / TILE)); j <= Math.min(last(state.height), Math.floor(v1 / TILE)); j++) {
          const tile = image(`${base}/${i}/${j}.jpg`);
          if (tile)
            draw2d.drawImage(tile, left + i * TILE * scale, top + j * TILE * scale,
              tile.naturalWidth * scale, tile.naturalHeight * scale);
        }
    }
    draw2d.filter = "none";
    paintMask();
    paintBox();
    paintMarks();
    paintCrops(ratio);
    if (isBrush() && cursor) {
      draw2d.beginPath();
      draw2d.arc(cursor[0], cursor[1], radius() * scale, 0, 7);
      draw2d.strokeStyle = "#fff";
      draw2d.lineWidth = 1.5;
      draw2d.stroke();
    }
  }

  const brightening = () => (state.gain > 1 ? `brightness(${state.gain})` : "none");

  function paintMask() {
    if (state.mask !== maskShown && !stroke) {
      const picture = state.mask && image(`/photoreg/mask/${state.mask}.png`);
      if (!state.mask || picture) {
        mask = document.createElement("canvas");
        const shrink = Math.min(1, 1600 / Math.max(state.width, state.height));
        mask.width = Math.max(1, Math.round(state.width * shrink));
        mask.height = Math.max(1, Math.round(state.height * shrink));
        if (picture) mask.getContext("2d").drawImage(picture, 0, 0, mask.width, mask.height);
        maskShown = state.mask;
      }
    }
    if (!mask) return;
    draw2d.globalAlpha = 0.5;
    draw2d.drawImage(mask, left, top, scale * state.width, scale * state.height);
    draw2d.globalAlpha = 1;
  }

  function paintBox() {
    const box = corners ? boxOf(corners) : state.box;
    if (!box) return;
    const place = [left + box[0] * scale, top + box[1] * scale, box[2] * scale, box[3] * scale];
    for (const [colour, dash] of [["#10403b", []], ["#2dd4bf", [6, 4]]]) {
      draw2d.strokeStyle = colour;
      draw2d.lineWidth = 2;
      draw2d.setLineDash(dash);
      draw2d.strokeRect(...place);
    }
    draw2d.setLineDash([]);
  }

  // Where the other photo has the points that are still to be clicked in this one.
  let cropsShown = "[]";
  function paintCrops(ratio) {
    const crops = state.crops ?? [];
    const wanted = JSON.stringify(crops);
    const wholes = crops.map(({ photo }) => image(`/photoreg/photo/${photo}/overview.jpg`));
    if (wanted === cropsShown || wholes.includes(null)) return;
    cropsShown = wanted;
    find(".pr-crops").replaceChildren(
      ...crops.map(({ n, name, u, v, width, height }, i) => {
        const crop = document.createElement("canvas");
        const half = CROP_PX / 2;
        crop.width = crop.height = CROP_PX * ratio;
        crop.title = `Point ${n} in ${name}`;
        crop.setAttribute("role", "img");
        crop.setAttribute("aria-label", crop.title);
        const pen = crop.getContext("2d");
        pen.scale(ratio, ratio);
        const { naturalWidth, naturalHeight } = wholes[i];
        pen.filter = brightening();
        pen.drawImage(wholes[i], half - ((u + 0.5) * naturalWidth) / width,
          half - ((v + 0.5) * naturalHeight) / height);
        pen.filter = "none";
        pen.font = "bold 12px sans-serif";
        for (const [colour, thick] of [["#000", 3], ["#ffd24d", 1.5]]) {
          pen.strokeStyle = pen.fillStyle = colour;
          pen.lineWidth = thick;
          pen.beginPath();
          pen.arc(half, half, 9, 0, 7);
          pen.stroke();
          if (thick > 2) pen.strokeText(n, half + 10, half - 8);
          else pen.fillText(n, half + 10, half - 8);
        }
        return crop;
      }),
    );
  }

  function paintMarks() {
    const wanted = state.pairs.filter((p) => p.u !== null);
    const known = new Map([...marks.children].map((m) => [+m.dataset.number, m]));
    for (const pair of wanted) {
      let mark = known.get(pair.n);
      if (!mark) {
        mark = document.createElement("div");
        mark.className = "pr-mark";
        mark.tabIndex = 0;
        mark.dataset.number = pair.n;
        mark.innerHTML = `<i></i><b>${pair.n}</b>`;
        mark.setAttribute("role", "button");
        mark.setAttribute("aria-label", `Point ${pair.n}`);
        marks.append(mark);
      }
      known.delete(pair.n);
      const moved = drag?.number === pair.n ? drag : pair;
      const [x, y] = toView(moved.u, moved.v);
      mark.style.left = `${x}px`;
      mark.style.top = `${y}px`;
      mark.style.setProperty("--c", pair.bad ? "#ff5f56" : pair.whole ? "#2dd4bf" : "#ffd24d");
      mark.classList.toggle("pr-chosen", pair.n === state.chosen);
      mark.title = pair.tip ?? "";
    }
    known.forEach((mark) => mark.remove());
  }

  // The hand.
  let press = null;
  view.addEventListener("pointerdown", (e) => {
    if (!state.photo || e.button > 2) return;
    const [x, y] = place(e);
    const mark = e.target.closest(".pr-mark");
    view.setPointerCapture(e.pointerId);
    press = { x, y, left, top, button: e.button, moved: false };
    if (mark && mode === "points" && e.button === 0) {
      const pair = state.pairs.find((p) => p.n === +mark.dataset.number);
      press.mark = pair;
      mark.focus({ preventScroll: true });
    } else if (isBrush() && e.button === 0 && !state.busy) {
      stroke = [toPhoto(x, y)];
      dab();
    } else if (mode === "box" && e.button === 0 && !state.busy) {
      corners = [toPhoto(x, y), toPhoto(x, y)];
    }
    e.preventDefault();
  });
  view.addEventListener("pointermove", (e) => {
    cursor = place(e);
    const [x, y] = cursor;
    if (state.photo) {
      const [u, v] = toPhoto(x, y);
      info.textContent = inside([u, v]) ? `${u.toFixed(1)}, ${v.toFixed(1)}` : "";
    }
    if (!press) return isBrush() && draw();
    press.moved ||= Math.hypot(x - press.x, y - press.y) >= CLICK_PX;
    if (stroke) {
      stroke.push(toPhoto(x, y));
      dab();
    } else if (corners) {
      corners[1] = toPhoto(x, y);
    } else if (press.mark) {
      if (!press.moved || state.busy) return;
      drag = {
        number: press.mark.n,
        u: press.mark.u + (x - press.x) / scale,
        v: press.mark.v + (y - press.y) / scale,
      };
    } else if (press.moved) {
      left = press.left + x - press.x;
      top = press.top + y - press.y;
    }
    draw();
  });
  const release = (e) => {
    if (!press) return;
    const was = press;
    press = null;
    if (stroke) {
      const path = stroke;
      stroke = null;
      maskShown = undefined;
      photoreg.send("paint", { photo: state.name, stroke: path, radius: radius(), counts: mode === "in" });
    } else if (corners) {
      const box = boxOf(corners);
      corners = null;
      if (was.moved && e.type === "pointerup") photoreg.send("box", { photo: state.name, box });
    } else if (was.mark && drag) {
      const { number, u, v } = drag;
      const pair = state.pairs.find((p) => p.n === number);
      if (inside([u, v])) {
        Object.assign(pair, { u, v });
        photoreg.send("move", { photo: state.name, number, u, v });
      }
    } else if (was.mark) {
      photoreg.send("choose", { photo: state.name, number: was.mark.n });
    } else if (!was.moved && was.button === 0 && mode === "points" && e.type === "pointerup") {
      const [u, v] = toPhoto(was.x, was.y);
      if (inside([u, v]) && !state.busy) photoreg.send("pick", { photo: state.name, u, v });
    }
    drag = null;
    draw();
  };
  view.addEventListener("pointerup", release);
  view.addEventListener("pointercancel", release);
  view.addEventListener("pointerleave", () => {
    cursor = null;
    info.textContent = "";
    draw();
  });
  view.addEventListener("contextmenu", (e) => e.preventDefault());
  view.addEventListener(
    "wheel",
    (e) => {
      if (!state.photo) return;
      e.preventDefault();
      e.stopPropagation();
      zoom(Math.exp(-0.0018 * e.deltaY), ...place(e));
    },
    { passive: false },
  );
  const STEPS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
  view.addEventListener("keydown", (e) => {
    const mark = e.target.closest?.(".pr-mark");
    const pair = mark && state.pairs.find((p) => p.n === +mark.dataset.number);
    if (pair && (e.key === "Delete" || e.key === "Backspace"))
      photoreg.send("delete", { photo: state.name, number: pair.n });
    else if (pair && STEPS[e.key]) {
      const [du, dv] = STEPS[e.key];
      const step = e.shiftKey ? 1 : 0.25;
      pair.u += du * step;
      pair.v += dv * step;
      photoreg.send("move", { photo: state.name, number: pair.n, u: pair.u, v: pair.v });
      draw();
    } else if (e.key === "Escape" && corners) {
      corners = press = null;
      draw();
    } else if (e.key === "Escape") photoreg.send("choose", { photo: state.name, number: null });
    else return;
    e.preventDefault();
    e.stopPropagation();
  });
  const setMode = (wanted) => {
    mode = wanted;
    for (const b of root.querySelectorAll("[data-mode]"))
      b.setAttribute("aria-pressed", b.dataset.mode === mode);
    show();
  };
  root.addEventListener("click", (e) => {
    const button = e.target.closest("button");
    if (!button) return;
    const { mode: wanted, do: action } = button.dataset;
    if (wanted) setMode(wanted);
    if (action === "fit") fit();
    if (action === "more") zoom(1.5);
    if (action === "less") zoom(1 / 1.5);
    if (action === "clear") photoreg.send("unmask", { photo: state.name });
    if (action === "unbox") photoreg.send("unbox", { photo: state.name });
    if (action === "large") {
      const large = root.classList.toggle("pr-large");
      (large ? document.body : home)?.append(root);
    }
    draw();
  });
  brush.addEventListener("input", draw);

  function dab() {
    if (!mask || stroke.length === 0) return;
    const pen = mask.getContext("2d");
    const shrink = mask.width / state.width;
    const [a, b] = [stroke.at(-2) ?? stroke.at(-1), stroke.at(-1)];
    pen.globalCompositeOperation = mode === "in" ? "destination-out" : "source-over";
    pen.strokeStyle = "rgb(255,70,70)";
    pen.lineCap = "round";
    pen.lineWidth = 2 * radius() * shrink;
    pen.beginPath();
    pen.moveTo((a[0] + 0.5) * shrink, (a[1] + 0.5) * shrink);
    pen.lineTo((b[0] + 0.5) * shrink + 0.01, (b[1] + 0.5) * shrink);
    pen.stroke();
    draw();
  }

  const HINTS = {
    out: () => "Paint over what is not the object.",
    in: () => "Paint what shall count again.",
    box: () =>
      state.mask
        ? "The mask tells where the object is; a box is for photos without one."
        : "Drag a box around the object; then Find this camera, in Align.",
    points: () => state.hint ?? "",
  };
  function show() {
    find(".pr-brush").style.display = isBrush() ? "flex" : "none";
    find(".pr-boxed").style.display = mode === "box" && state.box ? "flex" : "none";
    hint.textContent = HINTS[mode]();
  }

  // Clicks on the model place points while the picker is on screen, or the tab that it
  // was scrolled out of.
  let home = null;
  let shown = false;
  const seen = new Map();
  const sight = new IntersectionObserver((entries) => {
    for (const entry of entries) seen.set(entry.target, entry.isIntersecting);
    const now = [...seen.values()].some(Boolean);
    if (shown !== now) photoreg.send("picking", { on: (shown = now) });
  });
  photoreg.define("picker", (element) => {
    home = element.parentElement;
    if (!root.classList.contains("pr-large")) home.append(root);
    sight.disconnect();
    for (const target of seen.keys()) if (!target.isConnected) seen.delete(target);
    sight.observe(view);
    sight.observe(home.closest(".mantine-ScrollArea-content") ?? home);
    draw();
  });
  photoreg.define("picker-state", (element) => {
    const old = state;
    state = JSON.parse(element.dataset.state);
    if (old.photo !== state.photo) {
      mask = null;
      maskShown = undefined;
      stroke = corners = drag = press = null;
    }
    show();
    draw();
  });
  new ResizeObserver(() => {
    if (fitted && view.clientWidth) fitted = null;
    draw();
  }).observe(view);
  photoreg.picker = {
    setMode,
    toClient: (u, v) => {
      const box = view.getBoundingClientRect();
      const [x, y] = toView(u, v);
      return [box.left + x, box.top + y];
    },
    scale: () => scale,
    ready: () => Boolean(state.photo && fitted === state.photo),
  };
})();
