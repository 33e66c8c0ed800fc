"use strict";
/** Mouse, pen and finger on a panel: drags and the wheel. */
const pointer = (() => {
  /** Call dragged(dx, dy, moving) for each step of a drag in px, and zoomed(factor) for the wheel. */
  function listen(canvas, dragged, zoomed) {
    let last = null;
    canvas.addEventListener("pointerdown", (event) => {
      last = [event.clientX, event.clientY];
      canvas.setPointerCapture(event.pointerId);
    });
    canvas.addEventListener("pointermove", (event) => {
      if (!last) return;
      dragged(event.clientX - last[0], event.clientY - last[1], event.shiftKey || event.buttons === 2);
      last = [event.clientX, event.clientY];
    });
    for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, () => (last = null));
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      zoomed(Math.exp(-0.0015 * event.deltaY));
    }, { passive: false });
  }

  return { listen };
})();
