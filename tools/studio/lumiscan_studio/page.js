// A click on a heading sorts by that column, a second click the other way round.
for (const table of document.querySelectorAll("table")) {
  const headings = [...table.tHead.rows[0].cells];
  headings.forEach((heading, column) => heading.addEventListener("click", () => {
    const down = heading.dataset.down = heading.dataset.down === "1" ? "0" : "1";
    const value = (row) => row.cells[column].dataset.value ?? row.cells[column].textContent;
    const rows = [...table.tBodies[0].rows].sort((a, b) => value(a).localeCompare(value(b), undefined, { numeric: true }));
    if (down === "0") rows.reverse();
    table.tBodies[0].append(...rows);
  }));
}
