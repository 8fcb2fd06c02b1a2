"use strict";
(() => {
  const find = (selector) => [...document.querySelectorAll(selector)];
  const [body, search, unflagged, order, shown] =
    ["#rows", "#find", "#unflagged", "#order", "#shown"].map((id) => document.querySelector(id));
  const rows = [...body.rows];
  document.body.classList.add("scripted");

  const flagsOf = (row) => row.dataset.flags.split("; ").filter(Boolean);
  const wanted = () => new Set(find(".wanted:checked").map((box) => box.value));

  function isShown(row, flags, text) {
    if (unflagged.checked) { if (flagsOf(row).length) return false; }
    else if (flags.size && !flagsOf(row).some((flag) => flags.has(flag))) return false;
    return !text || row.dataset.well.toLowerCase() === text ||
      `${row.dataset.name} ${row.dataset.well}`.toLowerCase().includes(text);
  }

  function filter() {
    const flags = wanted(), text = search.value.trim().toLowerCase();
    let count = 0;
    for (const row of rows) {
      row.hidden = !isShown(row, flags, text);
      count += !row.hidden;
    }
    shown.textContent = `${count} of ${rows.length} shown`;
  }

  function sort() {
    const key = order.value, value = (row) => Number(row.dataset[key]);
    const known = (row) => (key === "number" || value(row) >= 0 ? 0 : 1);
    const sign = key === "blur" ? -1 : 1;
    const compare = key === "name"
      ? (a, b) => a.dataset.name.localeCompare(b.dataset.name, undefined, { numeric: true })
      : (a, b) => known(a) - known(b) || sign * (value(a) - value(b));
    rows.sort((a, b) => compare(a, b) || a.dataset.number - b.dataset.number);
    body.append(...rows);
  }

  function showAll() {
    find(".wanted").forEach((box) => { box.checked = false; });
    unflagged.checked = false;
    search.value = "";
    filter();
  }

  find(".wanted").forEach((box) => box.addEventListener("change", () => {
    unflagged.checked = false;
    filter();
  }));
  unflagged.addEventListener("change", () => {
    find(".wanted").forEach((box) => { box.checked = false; });
    filter();
  });
  search.addEventListener("input", filter);
  order.addEventListener("change", sort);
  document.querySelector("#all").addEventListener("click", showAll);
  find("a.well").forEach((link) => link.addEventListener("click", () => {
    showAll();
    search.value = link.dataset.well;
    filter();
  }));
  addEventListener("beforeprint", () => find("img").forEach((image) => { image.loading = "eager"; }));

  document.querySelector("#written").textContent =
    `; this file is of ${new Date(document.lastModified).toLocaleString()}`;
  order.value = "number";
  filter();
})();
