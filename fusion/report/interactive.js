// Draws the report's plots again with uPlot, where scripts run: zoom, values under the cursor, the nearest picture.
"use strict";
(() => {
  const data = JSON.parse(document.getElementById("flight-data").textContent);
  const bar = document.querySelector(".cursor-bar");
  if (!bar) return;
  const [slider, told, whole] = ["input", "output", "button"].map((tag) => bar.querySelector(tag));
  const picture = data.pictures.length ? document.createElement("img") : null;
  if (picture) bar.prepend(picture);
  const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
  const seconds = (v) => v.toFixed(2).replace(/^-(?=0\.00$)/, "");
  const power = (v) => (Math.abs(Math.log10(v) - Math.round(Math.log10(v))) < 1e-9 ? String(v) : ""); // of ten
  const charts = [];
  let zoom = null; // the part of the time that is shown, seconds; null: the whole flight

  const seriesOf = (s) => {
    const common = { label: s.label, stroke: () => css(s.colour), value: (_, v) => (v == null ? "–" : v.toPrecision(3)) };
    if (s.shape === "dot" || s.shape === "cross") {
      const hollow = s.shape === "cross";
      const points = { show: true, size: hollow ? 7 : 4, stroke: () => css(s.colour), fill: () => css(hollow ? "paper" : s.colour) };
      return [{ ...common, paths: () => null, points }];
    }
    if (s.shape === "band") {
      const edge = { ...common, width: 0, points: { show: false } };
      return [{ ...edge, label: `${s.label} +` }, { ...edge, label: `${s.label} −` }];
    }
    // A hole shorter than the stroke is wide would not show: a line that jumps from one corridor to the next.
    const gaps = (_, k, from, to, holes) => holes.map(([a, b]) => [a - 2 * devicePixelRatio, b + 2 * devicePixelRatio]);
    return [{ ...common, gaps, width: s.shape === "edge" ? 5 : 1.6, dash: s.shape === "dash" ? [6, 4] : undefined, points: { show: false } }];
  };

  const drawStatus = (u) => {
    const { left, top, width, height } = u.bbox;
    u.ctx.save();
    u.ctx.beginPath();
    u.ctx.rect(left, top, width, height);
    u.ctx.clip();
    const deep = 5 * devicePixelRatio;
    for (const [from, to, word] of data.status) {
      const a = u.valToPos(from, "x", true), b = u.valToPos(to, "x", true);
      u.ctx.fillStyle = css(`status-${word}`);
      u.ctx.fillRect(a, top + height - deep, Math.max(b - a, 1), deep);
    }
    u.ctx.strokeStyle = css("ink");
    u.ctx.setLineDash([2 * devicePixelRatio, 4 * devicePixelRatio]);
    for (const t of data.switches) {
      const x = u.valToPos(t, "x", true);
      u.ctx.beginPath();
      u.ctx.moveTo(x, top);
      u.ctx.lineTo(x, top + height);
      u.ctx.stroke();
    }
    u.ctx.restore();
  };

  const axis = (label) => ({
    label, labelSize: 20, stroke: () => css("ink"), font: "12px system-ui", labelFont: "12px system-ui",
    grid: { stroke: () => css("grid"), width: 1 }, ticks: { stroke: () => css("grid"), width: 1 },
  });

  const showTime = (t, from) => {
    slider.value = t;
    for (const u of charts) if (u !== from) u.setCursor({ left: u.valToPos(t, "x"), top: -10 }, false);
    const status = data.status.find(([a, b]) => a <= t && t <= b);
    let best = null;
    for (const p of data.pictures) if (best === null || Math.abs(p.t - t) < Math.abs(best.t - t)) best = p;
    if (picture && picture.dataset.t !== String(best.t)) {
      picture.src = best.src;
      picture.dataset.t = best.t;
      picture.alt = `Frame at ${best.t.toFixed(2)} s with its lines`;
    }
    const frame = best ? `; picture of ${best.t.toFixed(2)} s: ${best.said}` : "";
    told.textContent = `${t.toFixed(2)} s${status ? `, ${status[2]}` : ""}${frame}`;
  };

  const showSpan = (min, max) => {
    zoom = min === null ? null : [min, max];
    for (const u of charts) {
      const [a, b] = zoom ?? u.whole;
      if (u.scales.x.min !== a || u.scales.x.max !== b) u.setScale("x", { min: a, max: b });
    }
  };

  const build = (place, panel) => {
    const joined = uPlot.join(panel.series.map((s) => (s.shape === "band" ? [s.x, s.high, s.y] : [s.x, s.y])));
    const series = [{ label: "Time", value: (_, v) => (v == null ? "–" : `${seconds(v)} s`) }];
    const bands = [];
    for (const s of panel.series) {
      if (s.shape === "band") bands.push({ series: [series.length, series.length + 1], fill: () => `${css(s.colour)}38` });
      series.push(...seriesOf(s));
    }
    const fit = (u, low, high) => (zoom && !panel.log && low !== null ? uPlot.rangeNum(low, high, 0.1, true) : panel.y);
    const u = new uPlot({
      width: place.clientWidth, height: 260, series, bands,
      scales: { x: { time: false, range: (_, a, b) => (zoom ? [a, b] : panel.x) }, y: { distr: panel.log ? 3 : 1, range: fit } },
      axes: [{ ...axis("Time, s"), size: 30 }, { ...axis(panel.label), size: 56, ...(panel.log ? { values: (_, ticks) => ticks.map(power) } : {}) }],
      cursor: { drag: { x: true, y: false, setScale: false }, points: { size: 6 }, y: false },
      legend: { live: true },
      hooks: {
        draw: [drawStatus],
        setCursor: [(c) => { if (c.cursor.event) showTime(c.posToVal(c.cursor.left, "x"), c); }],
        setSelect: [(c) => {
          if (c.select.width < 3) return;
          const [a, b] = [c.select.left, c.select.left + c.select.width].map((px) => c.posToVal(px, "x"));
          c.setSelect({ left: 0, width: 0, top: 0, height: 0 }, false);
          showSpan(a, b);
        }],
      },
    }, joined, place);
    u.whole = panel.x;
    u.over.addEventListener("dblclick", () => showSpan(null));
    new ResizeObserver(() => { if (place.clientWidth && place.clientWidth !== u.width) u.setSize({ width: place.clientWidth, height: 260 }); }).observe(place);
    charts.push(u);
  };

  document.documentElement.classList.add("scripted");
  for (const place of document.querySelectorAll(".interactive"))
    for (const panel of data.charts[place.dataset.figure]) build(place.appendChild(document.createElement("div")), panel);
  const [start, end] = charts.length ? charts[0].whole : [0, 1];
  Object.assign(slider, { min: Math.max(start, 0), max: end });
  slider.addEventListener("input", () => showTime(Number(slider.value)));
  whole.addEventListener("click", () => showSpan(null));
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => charts.forEach((u) => u.redraw()));
  showTime(Math.max(start, 0));
})();
