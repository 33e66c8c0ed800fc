"use strict";
/** The list of sequences and items: only the rows in sight are in the document. */
const list = (() => {
  const ROW = 24; // px, as in the style
  const LETTER = 7; // px, of a usual letter

  /** A text of so many letters: what is left out is in the middle, for names begin alike. */
  function shortened(text, letters) {
    const letters_ = [...text];
    if (letters_.length <= letters || letters < 8) return text;
    const end = Math.ceil(0.6 * (letters - 1));
    return `${letters_.slice(0, letters - 1 - end).join("")}…${letters_.slice(-end).join("")}`;
  }

  /** Fill `box` with rows; `labels(row)` gives {text, kind}, `choose(row)` is called on a click. */
  function make(box, labels, choose) {
    const holder = box.firstElementChild;
    let [rows, chosen] = [[], -1];

    function draw() {
      const first = Math.max(0, Math.floor(box.scrollTop / ROW) - 2);
      const last = Math.min(rows.length, first + Math.ceil(box.clientHeight / ROW) + 5);
      holder.replaceChildren();
      for (let index = first; index < last; index++) {
        const { text, kind } = labels(rows[index]);
        const row = document.createElement("div");
        row.id = `row-${index}`;
        row.className = kind;
        row.title = text;
        row.textContent = shortened(text, Math.floor((box.clientWidth - 32) / LETTER));
        row.style.top = `${index * ROW}px`;
        row.setAttribute("role", "option");
        row.setAttribute("aria-setsize", rows.length);
        row.setAttribute("aria-posinset", index + 1);
        row.setAttribute("aria-selected", index === chosen);
        row.addEventListener("click", () => choose(rows[index]));
        holder.append(row);
      }
      if (chosen >= first && chosen < last) box.setAttribute("aria-activedescendant", `row-${chosen}`);
      else box.removeAttribute("aria-activedescendant");
    }

    function show(newRows) {
      rows = newRows;
      holder.style.height = `${rows.length * ROW}px`;
      draw();
    }

    /** Mark the row that `is` accepts, and scroll to it. */
    function mark(is) {
      chosen = rows.findIndex(is);
      if (chosen >= 0) {
        if (chosen * ROW < box.scrollTop) box.scrollTop = chosen * ROW;
        if ((chosen + 1) * ROW > box.scrollTop + box.clientHeight) box.scrollTop = (chosen + 1) * ROW - box.clientHeight;
      }
      draw();
    }

    box.addEventListener("scroll", draw);
    box.addEventListener("keydown", (event) => {
      const step = { ArrowDown: 1, ArrowUp: -1 }[event.key];
      if (!step || !rows.length || event.altKey) return;
      event.preventDefault();
      event.stopPropagation();
      choose(rows[Math.max(0, Math.min(rows.length - 1, chosen + step))]);
    });
    return { show, mark, draw };
  }

  return { make, shortened };
})();
if (typeof module !== "undefined") module.exports = list;
