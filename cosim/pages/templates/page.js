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
  if (hasList) arrange();
}

async function follow(plots) {
  for (let version = page.version, wait = 500; ;) {
    await new Promise((resolve) => setTimeout(resolve, wait));
    let answer;
    try {
      answer = await fetch(`data?since=${version}`);
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
    tell(news.state);
    if (news.is_final) {
      fetch(`data?since=${version}&has=all`).catch(() => {});
      return;
    }
  }
}

const sorted = {column: -1, sign: 1};

function arrange() {
  const body = document.getElementById("rows");
  const rows = [...body.rows];
  const words = document.getElementById("filter").value.toLowerCase().split(/\s+/).filter(Boolean);
  for (const row of rows) row.classList.toggle("hidden", !words.every((w) => row.textContent.toLowerCase().includes(w)));
  document.getElementById("n-shown").textContent = rows.filter((row) => !row.classList.contains("hidden")).length;
  if (sorted.column < 0) return;
  const key = (row) => row.cells[sorted.column].dataset.value ?? row.cells[sorted.column].textContent;
  const compare = (a, b) => {
    const [x, y] = [key(a), key(b)];
    const isText = [x, y].some((text) => text === "" || Number.isNaN(Number(text)));
    return sorted.sign * (isText ? x.localeCompare(y) : x - y);
  };
  body.append(...rows.sort(compare));
}

function listing() {
  document.getElementById("filter").addEventListener("input", arrange);
  document.querySelectorAll("#runs th").forEach((head, i) => {
    head.dataset.sort = "";
    head.addEventListener("click", () => {
      sorted.sign = sorted.column === i ? -sorted.sign : 1;
      sorted.column = i;
      arrange();
    });
  });
}

const hasList = document.getElementById("filter") !== null;
if (hasList) listing();
const drawn = page.item ? Bokeh.embed.embed_item(page.item, "plots") : Promise.resolve();
drawn.then(() => {
  const plots = page.item ? Bokeh.documents[0] : null;
  choose(plots);
  if (page.is_live) follow(plots);
  document.body.dataset.ready = "yes";
});
