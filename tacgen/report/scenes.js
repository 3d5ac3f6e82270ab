"use strict";
(() => {
const list = document.querySelector("ol.scenes"), all = [...list.children], by = (id) => document.getElementById(id);
function filter() {
  const words = by("words").value.toLowerCase().split(/\s+/), least = +by("least").value || 0;
  const fits = ({ dataset }) => words.every((word) => dataset.words.includes(word)) && (!least || +dataset.peak >= least)
    && ["shape", "movement", "state"].every((name) => !by(name)?.value || by(name).value === dataset[name]);
  for (const item of all) item.hidden = !fits(item);
  by("count").textContent = `${all.filter((item) => !item.hidden).length} of ${all.length}`;
}
for (const id of ["words", "least", "shape", "movement", "state"]) by(id)?.addEventListener("input", filter);
by("order").oninput = () => {
  const key = by("order").value, sign = key === "peak" ? -1 : 1;
  list.append(...[...all].sort((a, b) => sign * (a.dataset[key] - b.dataset[key])));
};
list.onclick = (event) => {
  if (event.target.closest("a")) for (const item of all) item.classList.toggle("on", item.contains(event.target));
};
filter();
if (document.querySelector("iframe")) list.querySelector("a")?.click();
})();
