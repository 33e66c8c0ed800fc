"use strict";
if (matchMedia("(prefers-color-scheme: dark)").matches) document.documentElement.dataset.theme = "dark";

/** Tables of a report: a click on the head of a column sorts by it. */
for (const table of document.querySelectorAll("table")) {
  /* The first number of a cell such as "0.12 / 0.10" or "97.5 %"; what has none stands last. */
  const number = (text) => parseFloat(text.replaceAll(",", ""));
  const compare = (a, b) => Number.isNaN(number(a)) - Number.isNaN(number(b)) || number(a) - number(b) || a.localeCompare(b);

  [...table.tHead.rows[0].cells].forEach((head, column) => {
    if (!head.textContent) return;
    const button = Object.assign(document.createElement("button"), { type: "button" });
    button.append(...head.childNodes);
    button.addEventListener("click", () => {
      const sign = head.getAttribute("aria-sort") === "ascending" ? -1 : 1;
      for (const other of table.tHead.rows[0].cells) other.removeAttribute("aria-sort");
      head.setAttribute("aria-sort", sign > 0 ? "ascending" : "descending");
      const text = (row) => row.cells[column].textContent;
      table.tBodies[0].append(...[...table.tBodies[0].rows].sort((a, b) => sign * compare(text(a), text(b))));
    });
    head.append(button);
  });
}
