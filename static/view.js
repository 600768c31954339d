// The wheel and the mouse of Inspect, and buttons that repeat while they are held.
(() => {
  const photoreg = (window.photoreg ??= {});
  const viewer = () => window.__viserMutable;

  // Buttons that repeat while they are held.
  let timer = null;
  const release = () => {
    clearInterval(timer);
    timer = null;
  };
  photoreg.hold = (event, act, { value }) => {
    if (event.button !== 0) return;
    release();
    const began = performance.now();
    const size = event.shiftKey ? "+" : event.altKey ? "-" : "";
    const send = () => photoreg.send(act, { value: value + size });
    send();
    timer = setInterval(() => {
      if (performance.now() - began > 350) send();
    }, 80);
  };
  for (const name of ["pointerup", "pointercancel"])
    window.addEventListener(name, release, true);
  window.addEventListener("blur", release); // The window's, not that of a button.

  // Inspect: the camera stays, the wheel zooms by the field of view and a drag takes
  // the picture along; both only turn the view about the camera's centre.
  let fit = null; // Vertical field of view, in degrees, that shows the whole photo.
  const MOST = 64;
  const slope = (degrees) => Math.tan((degrees * Math.PI) / 360);
  const over = (event) => fit !== null && event.target === viewer().canvas;
  const setSpeeds = () => {
    const control = viewer().cameraControl;
    // The library turns by 2 pi a canvas height; backwards, for all that is seen lies
    // beyond the pivot.
    const speed =
      fit === null ? 1 : -(viewer().camera.fov * Math.PI) / 180 / (2 * Math.PI);
    control.azimuthRotateSpeed = control.polarRotateSpeed = speed;
    control.mouseButtons.right = fit === null ? 2 : 1; // Truck, or rotate.
    control.mouseButtons.middle = fit === null ? 16 : 1; // Dolly, or rotate.
  };
  const zoom = (factor, event) => {
    const { camera, cameraControl, canvas } = viewer();
    const box = canvas.getBoundingClientRect();
    const old = slope(camera.fov);
    const next = Math.min(Math.max(old / factor, slope(fit) / MOST), slope(fit) * 1.5);
    camera.fov = (Math.atan(next) * 360) / Math.PI;
    camera.updateProjectionMatrix();
    // What is under the cursor stays there.
    const x = (2 * (event.clientX - box.left) - box.width) / box.height;
    const y = (2 * (event.clientY - box.top)) / box.height - 1;
    cameraControl.rotate(
      Math.atan(x * next) - Math.atan(x * old),
      Math.atan(y * next) - Math.atan(y * old),
      false,
    );
    viewer().sendCamera();
    viewer().requestRender();
  };
  photoreg.define("inspect", (element) => {
    fit = JSON.parse(element.dataset.fit);
    if (viewer()?.cameraControl) setSpeeds();
  });
  window.addEventListener(
    "wheel",
    (event) => {
      if (!over(event)) return;
      event.preventDefault();
      event.stopImmediatePropagation();
      zoom(2 ** (-event.deltaY / 300), event);
    },
    { capture: true, passive: false },
  );
  window.addEventListener(
    "pointerdown",
    (event) => {
      if (over(event)) setSpeeds();
      // Its listener on the canvas is a passive one, in which viser prevents the default
      // all the same: without effect, but for a complaint in the console.
      if (event.target === viewer()?.canvas) event.preventDefault = () => {};
    },
    true,
  );
  // The keys that walk would leave the camera; arrows turn by a tenth of what is seen.
  const walk = /^(Key[WASDQE]|Arrow(Left|Right|Up|Down))$/;
  // On a slider the arrows move it, and nothing else: viser hears them at the document.
  const isOnSlider = (event) =>
    event.code.startsWith("Arrow") && event.target.closest?.("[role=slider]");
  document.body.addEventListener("keydown", (event) => {
    if (isOnSlider(event)) event.stopPropagation();
  });
  window.addEventListener(
    "keydown",
    (event) => {
      if (fit === null || !walk.test(event.code)) return;
      if (/^(INPUT|TEXTAREA|SELECT)$/.test(event.target.tagName)) return;
      if (isOnSlider(event)) return;
      event.stopPropagation();
      const step = (viewer().camera.fov * Math.PI) / 1800;
      const turn = {
        ArrowLeft: [step, 0],
        ArrowRight: [-step, 0],
        ArrowUp: [0, step],
        ArrowDown: [0, -step],
      }[event.code];
      if (turn) viewer().cameraControl.rotate(turn[0], turn[1], false);
    },
    true,
  );
})();
