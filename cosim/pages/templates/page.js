"use strict";
const page = JSON.parse(document.getElementById("page").textContent);

const numbers = (text) => new Float64Array(Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer);
const column = (packed) => (Array.isArray(packed) ? packed : numbers(packed.f8));

function choose(plots) {
  for (const box of document.querySelectorAll("input[data-run]")) {
    const show = () => {
      for (const id of page.renderers[box.dataset.run] ?? []) plots.get_model_by_id(id).visible = box.checked;
    };
    box.addEventListener("change", show);
    show();
  }
}

function tell(text) {
  document.getElementById("state").textContent = text;
}

function put(plots, news) {
  for (const [name, columns] of Object.entries(news.columns)) {
    const data = Object.fromEntries(Object.entries(columns).map(([key, packed]) => [key, column(packed)]));
    plots.get_model_by_name(name).data = data;
  }
  for (const [name, [start, end]] of Object.entries(news.ranges)) {
    const [before, after] = page.ranges[name];
    if (before !== start || after !== end) plots.get_model_by_name(name).setv({start, end});
    page.ranges[name] = [start, end];
  }
  for (const [id, html] of Object.entries(news.parts)) {
    const part = document.getElementById(id);
    const tops = [...part.querySelectorAll(".scroll")].map((box) => box.scrollTop);
    const open = [...part.querySelectorAll("details")].map((box) => box.open);
    part.innerHTML = html;
    part.querySelectorAll(".scroll").forEach((box, i) => { box.scrollTop = tops[i] ?? 0; });
    part.querySelectorAll("details").forEach((box, i) => { box.open = open[i] ?? false; });
  }
}

async function follow(plots) {
  for (let version = page.version, wait = 500; ;) {
    await new Promise((resolve) => setTimeout(resolve, wait));
    let answer;
    try {
      answer = await fetch(`${location.pathname.replace(/\/$/, "")}/data?since=${version}`);
    } catch {
      tell("retune view has ended: the page stays as it is.");
      return;
    }
    if (!answer.ok) { tell(await answer.text()); wait = 5000; continue; }
    const news = await answer.json();
    wait = news.wait_ms;
    if (news.structure !== undefined && news.structure !== page.structure) { location.reload(); return; }
    if (news.columns) put(plots, news);
    version = news.version;
    tell(news.is_final ? "The run has ended: the page is complete." : "The page grows with the run.");
    if (news.is_final) return;
  }
}

function listing() {
  const search = document.getElementById("filter");
  if (!search) return;
  const rows = [...document.querySelectorAll("#runs tbody tr")];
  search.addEventListener("input", () => {
    const words = search.value.toLowerCase().split(/\s+/).filter(Boolean);
    for (const row of rows) row.classList.toggle("hidden", !words.every((w) => row.textContent.toLowerCase().includes(w)));
    document.getElementById("n-shown").textContent = rows.filter((row) => !row.classList.contains("hidden")).length;
  });
  document.querySelectorAll("#runs th").forEach((head, i) => {
    head.dataset.sort = "";
    let sign = -1;
    head.addEventListener("click", () => {
      sign = -sign;
      const key = (row) => row.cells[i].dataset.value ?? row.cells[i].textContent;
      const compare = (a, b) => {
        const [x, y] = [key(a), key(b)];
        const [p, q] = [parseFloat(x), parseFloat(y)];
        return sign * (Number.isNaN(p) || Number.isNaN(q) ? x.localeCompare(y) : p - q);
      };
      document.querySelector("#runs tbody").append(...[...rows].sort(compare));
    });
  });
}

listing();
if (page.item) {
  Bokeh.embed.embed_item(page.item, "plots").then((views) => {
    const plots = Bokeh.documents[0];
    choose(plots);
    if (page.is_live) follow(plots);
    document.body.dataset.ready = "yes";
  });
} else {
  document.body.dataset.ready = "yes";
}
