"use strict";
{
  const form = document.querySelector("form");
  const value = (row, column) => {
    const cell = row.cells[column];
    if (!("value" in cell.dataset)) return cell.textContent.trim();
    return cell.dataset.value === "" ? null : Number(cell.dataset.value);
  };
  // What was not measured stays last, in either direction.
  const compare = (a, b, sign) => {
    if (a === null || b === null) return (a === null) - (b === null);
    return sign * (typeof a === "number" ? a - b : a.localeCompare(b));
  };
  const sort = (heading) => {
    const column = heading.cellIndex;
    const body = heading.closest("table").tBodies[0];
    const before = heading.getAttribute("aria-sort");
    // Numbers begin with the largest.
    const first = heading.classList.contains("number") ? "descending" : "ascending";
    const second = first === "ascending" ? "descending" : "ascending";
    const order = before === first ? second : first;
    for (const other of heading.parentElement.cells) other.removeAttribute("aria-sort");
    heading.setAttribute("aria-sort", order);
    const sign = order === "ascending" ? 1 : -1;
    body.append(...[...body.rows].sort((a, b) => compare(value(a, column), value(b, column), sign)));
  };
  const filter = () => {
    const { suite, text, complete } = form.elements;
    const words = text.value.toLowerCase().split(/\s+/);
    let shown = 0;
    for (const section of document.querySelectorAll("section")) {
      let left = 0;
      for (const row of section.querySelectorAll("tbody tr")) {
        const names = [0, 1, 2].map((column) => row.cells[column].textContent.toLowerCase()).join(" ");
        const fits = words.every((word) => names.includes(word));
        row.hidden = !fits || (complete.checked && row.classList.contains("incomplete"));
        left += !row.hidden;
      }
      for (const table of section.querySelectorAll(".scroll")) {
        table.hidden = !table.querySelector("tbody tr:not([hidden])");
      }
      section.hidden = left === 0 || (suite.value !== "" && section.dataset.suite !== suite.value);
      if (!section.hidden) shown += left;
    }
    form.querySelector("output").textContent = `${shown} results`;
  };
  document.addEventListener("click", (event) => {
    if (event.target.matches("thead button")) sort(event.target.closest("th"));
  });
  form.addEventListener("input", filter);
  form.addEventListener("submit", (event) => event.preventDefault());
  filter();
}
