// Boxes above a table that leave only the rows with what is chosen in them.
for (const table of document.querySelectorAll("table:has(th[data-choice])")) {
  const rows = [...table.tBodies[0].rows];
  const heads = [...table.tHead.rows[0].cells];
  const choices = [];
  const bar = document.createElement("div");
  bar.className = "filter";
  bar.setAttribute("role", "group");
  bar.setAttribute("aria-label", `Filter: ${table.caption.textContent}`);
  const add = (words, control) => {
    const label = document.createElement("label");
    label.append(`${words} `, control);
    bar.append(label);
    control.addEventListener("input", apply);
  };
  const text = (row, column) => row.cells[column].textContent.trim();
  const whole = (row) => [...row.cells].map((cell) => cell.textContent).join(" ").toLowerCase();
  const find = document.createElement("input");
  find.type = "search";
  const said = document.createElement("span");
  said.setAttribute("role", "status");
  const total = Number(table.dataset.total);
  const behind = total > rows.length ? ` (of ${total} in all: the others are not on this page)` : "";

  function apply() {
    const words = find.value.toLowerCase().split(/\s+/).filter(Boolean);
    let shown = 0;
    for (const row of rows) {
      const chosen = choices.every(({ select, values, column }) =>
        !select.selectedIndex || text(row, column) === values[select.selectedIndex - 1]);
      const all = words.length ? whole(row) : "";
      row.hidden = !chosen || !words.every((word) => all.includes(word));
      shown += !row.hidden;
    }
    said.textContent = `${shown} of ${rows.length} rows${behind}`;
  }

  heads.forEach((head, column) => {
    if (!("choice" in head.dataset)) return;
    const key = (row) => Number(row.cells[column].dataset.sort || NaN);
    const order = (a, b) => key(a) - key(b) || (text(a, column) < text(b, column) ? -1 : 1);
    const values = [...new Set([...rows].sort(order).map((row) => text(row, column)))];
    if (values.length < 2) return;
    const select = document.createElement("select");
    select.append(...["all", ...values].map((value) => new Option(value || "(none)")));
    choices.push({ select, values, column });
    add(head.textContent.trim(), select);
  });
  add("words", find);
  bar.append(said);
  table.closest(".box").before(bar);
  apply();
}
