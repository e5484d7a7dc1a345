"use strict";
(() => {
  const root = document.documentElement, pages = [...document.querySelectorAll(".page")];
  root.classList.add("js");

  const show = (move) => {
    let target = null;
    try { target = document.getElementById(decodeURIComponent(location.hash.slice(1))); } catch { }
    const page = (target && target.closest(".page")) || pages[0];
    pages.forEach((one) => one.classList.toggle("now", one === page));
    if (!move) return;
    (target || page).focus({ preventScroll: true });
    if (target && target !== page) target.scrollIntoView(); else scrollTo(0, 0);
  };
  addEventListener("hashchange", () => show(true));
  show(Boolean(location.hash));

  const value = (row, column) => {
    const cell = row.cells[column];
    if (!("v" in cell.dataset)) return cell.textContent.trim();
    return cell.dataset.v === "" ? null : Number(cell.dataset.v);
  };
  const compare = (a, b) => typeof a === "number" ? a - b : a.localeCompare(b, "en", { numeric: true });
  const sort = (table, head) => {
    const down = head.getAttribute("aria-sort") === "ascending", column = head.cellIndex, body = table.tBodies[0];
    const rows = [...body.rows].map((row) => [value(row, column), row]);
    rows.sort(([a], [b]) => a === null || b === null ? (a === null) - (b === null) : (down ? -1 : 1) * compare(a, b));
    table.querySelectorAll("th[aria-sort]").forEach((one) => one.removeAttribute("aria-sort"));
    head.setAttribute("aria-sort", down ? "descending" : "ascending");
    body.append(...rows.map(([, row]) => row));
  };
  document.querySelectorAll("table.sortable").forEach((table) => {
    table.querySelectorAll("thead th").forEach((head) => {
      const button = document.createElement("button");
      button.type = "button";
      button.append(...head.childNodes);
      head.append(button);
      button.addEventListener("click", () => sort(table, head));
    });
  });

  const filter = document.getElementById("filter"), rows = [...document.querySelectorAll("#table tbody tr")];
  const count = document.getElementById("count");
  filter.closest("p").hidden = false;
  const texts = rows.map((row) => [...row.cells].map((cell) => cell.textContent).join(" ").toLowerCase());
  const sift = () => {
    const words = filter.value.toLowerCase().split(/\s+/).filter(Boolean);
    let shown = 0;
    rows.forEach((row, i) => {
      row.hidden = !words.every((word) => texts[i].includes(word));
      shown += row.hidden ? 0 : 1;
    });
    count.textContent = words.length ? `${shown} of ${rows.length} shown` : "";
  };
  filter.addEventListener("input", sift);
  sift();
})();
