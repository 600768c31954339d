// Before and after: the line that is dragged, and the button that blinks. The page has it,
// and the report of a run within itself.
document.addEventListener("input", ({ target }) => {
  if (target.dataset.swipe !== undefined)
    target.parentNode.style.setProperty("--x", `${target.value}%`);
});
document.addEventListener("click", ({ target }) => {
  if (target.dataset.blink !== undefined)
    target.previousElementSibling.classList.toggle("blink");
});
