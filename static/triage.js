// The triage page of a batch: filters, search, sorting, and commands to be copied.
const list = document.querySelector("main");
const rows = [...list.querySelectorAll("article")];
const chips = [...document.querySelectorAll("[data-filter]")];
const search = document.getElementById("search");
const sort = document.getElementById("sort");
const empty = list.querySelector(".empty");

// Where a number is not known, an object stands last.
const number = (row, name) => (row.dataset[name] === "" ? -Infinity : +row.dataset[name]);
const orders = {
  rank: (a, b) => a.dataset.rank - b.dataset.rank,
  error: (a, b) => number(b, "error") - number(a, "error") || orders.rank(a, b),
  time: (a, b) => number(b, "time") - number(a, "time") || orders.rank(a, b),
  name: (a, b) =>
    a.dataset.name.localeCompare(b.dataset.name, undefined, { numeric: true }),
};

function show() {
  const wanted = chips
    .filter((chip) => chip.getAttribute("aria-pressed") === "true")
    .map((chip) => chip.dataset.filter);
  const words = search.value.trim().toLowerCase();
  let shown = 0;
  for (const row of rows) {
    row.hidden =
      (wanted.length > 0 && !wanted.includes(row.dataset.key)) ||
      !row.dataset.name.toLowerCase().includes(words);
    shown += !row.hidden;
  }
  empty.hidden = shown > 0;
}

for (const chip of chips)
  chip.addEventListener("click", () => {
    const pressed = chip.getAttribute("aria-pressed") === "true";
    chip.setAttribute("aria-pressed", String(!pressed));
    show();
  });
search.addEventListener("input", show);
sort.addEventListener("change", () => {
  rows.sort(orders[sort.value]);
  list.prepend(...rows);
});

// Some browsers keep the clipboard from pages that come from the disk.
function copyBySelection(text) {
  const field = document.createElement("textarea");
  field.value = text;
  document.body.append(field);
  field.select();
  const done = document.execCommand("copy");
  field.remove();
  return done;
}

document.addEventListener("click", async ({ target }) => {
  const text = target.dataset.copy;
  if (text === undefined) return;
  let done = true;
  try {
    await navigator.clipboard.writeText(text);
  } catch {
    done = copyBySelection(text);
  }
  target.textContent = done ? "Copied" : "Select it by hand";
  setTimeout(() => (target.textContent = "Copy"), 1500);
});
