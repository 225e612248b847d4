// Plots to zoom into, with the picture nearest to the cursor. Data: fusion.report.explore. Plots: uPlot.
(() => {
  const data = JSON.parse(document.getElementById("flight-data").textContent);
  const section = document.getElementById("explore");
  const place = document.getElementById("explore-plots");
  const slider = document.getElementById("explore-time");
  const picture = document.getElementById("explore-picture");
  const said = document.getElementById("explore-said");
  section.hidden = false;

  const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue("--" + name).trim();
  const number = (value, digits) => (value == null ? "–" : value.toFixed(digits));
  const times = data.t_s;
  let charts = [];
  let moving = false;

  function nearest(list, t, time) {
    let low = 0, high = list.length - 1;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (time(list[middle]) < t) low = middle + 1; else high = middle;
    }
    return low > 0 && t - time(list[low - 1]) < time(list[low]) - t ? low - 1 : low;
  }

  function showAt(t) {
    slider.value = t;
    slider.setAttribute("aria-valuetext", number(t, 2) + " seconds");
    if (!data.pictures.length) return;
    const shown = data.pictures[nearest(data.pictures, t, (p) => p.t_s)];
    picture.src = shown.uri;
    picture.alt = "Frame at " + number(shown.t_s, 2) + " s";
    said.textContent = "Frame at " + number(shown.t_s, 2) + " s, " + shown.words;
  }

  function series(one, digits) {
    const stroke = colour(one.colour);
    const isBand = one.name === "low" || one.name === "high";
    const isDots = one.name === "frames";
    return {
      label: { low: "two sigma, from", high: "to" }[one.name] || one.name,
      stroke: isBand ? "transparent" : stroke,
      width: one.name === "filter" ? 2 : 1.2,
      dash: one.name === "truth" ? [6, 4] : undefined,
      paths: isDots ? () => null : undefined,
      points: { show: isDots, size: 4, fill: stroke, stroke },
      value: (_, v) => number(v, digits),
    };
  }

  function chart(plot) {
    const digits = plot.unit.startsWith("degrees") ? 2 : 3;
    const axis = { stroke: colour("faint"), grid: { stroke: colour("grid"), width: 1 }, ticks: { stroke: colour("grid"), width: 1 } };
    const options = {
      title: plot.title + ", " + plot.unit,
      width: place.clientWidth,
      height: 230,
      cursor: { sync: { key: "flight" }, drag: { x: true, y: false } },
      scales: { x: { time: false } },
      axes: [{ ...axis }, { ...axis, size: 56 }],
      series: [{ label: "time, s", value: (_, v) => number(v, 2) }, ...plot.series.map((one) => series(one, digits))],
      bands: [{ series: [2, 1], fill: colour("filter") + "33" }],
      hooks: {
        setCursor: [(u) => { if (u.cursor.idx != null) showAt(times[u.cursor.idx]); }],
        setScale: [(u, key) => {
          if (key !== "x" || moving) return;
          moving = true;
          for (const other of charts) if (other !== u) other.setScale("x", { min: u.scales.x.min, max: u.scales.x.max });
          moving = false;
        }],
      },
    };
    return new uPlot(options, [times, ...plot.series.map((one) => one.values)], place);
  }

  function build() {
    for (const u of charts) u.destroy();
    charts = data.plots.map(chart);
  }

  slider.min = times[0];
  slider.max = times[times.length - 1];
  slider.addEventListener("input", () => {
    const t = Number(slider.value);
    const u = charts[0];
    if (t < u.scales.x.min || t > u.scales.x.max) u.setScale("x", { min: times[0], max: times[times.length - 1] });
    u.setCursor({ left: u.valToPos(t, "x"), top: 10 });
    showAt(t);
  });
  build();
  showAt(times[Math.floor(times.length / 2)]);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", build);
  new ResizeObserver(() => {
    for (const u of charts) if (u.width !== place.clientWidth) u.setSize({ width: place.clientWidth, height: 230 });
  }).observe(place);
})();
