// The heading of a column becomes a button that sorts by it.
for (const table of document.querySelectorAll("table.sortable")) {
  const heads = [...table.tHead.rows[0].cells];
  const body = table.tBodies[0];
  if (body.rows.length < 2) continue;
  heads.forEach((head, column) => {
    const button = document.createElement("button");
    button.type = "button";
    button.append(...head.childNodes);
    head.append(button);
    button.addEventListener("click", () => {
      const up = head.getAttribute("aria-sort") !== "ascending";
      for (const other of heads) other.removeAttribute("aria-sort");
      head.setAttribute("aria-sort", up ? "ascending" : "descending");
      const numeric = head.classList.contains("n");
      const key = (row) => {
        const cell = row.cells[column];
        if (!numeric) return cell.textContent;
        return cell.dataset.sort === "" ? NaN : Number(cell.dataset.sort);
      };
      const rows = [...body.rows].map((row, place) => ({ row, key: key(row), place }));
      rows.sort((a, b) => {
        if (numeric) {
          const empty = Number.isNaN(a.key) - Number.isNaN(b.key);
          if (empty) return empty; // what has no value stays at the end
          const step = Number.isNaN(a.key) ? 0 : a.key - b.key;
          return (up ? step : -step) || a.place - b.place;
        }
        const step = a.key < b.key ? -1 : Number(a.key > b.key);
        return (up ? step : -step) || a.place - b.place;
      });
      body.append(...rows.map((entry) => entry.row));
    });
  });
}
