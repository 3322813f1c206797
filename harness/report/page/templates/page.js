"use strict";
(() => {
  const content = JSON.parse(document.getElementById("data").textContent);
  const dark = window.matchMedia("(prefers-color-scheme: dark)");
  const hidden = new Set();
  const drawn = new Map();
  const config = { responsive: true, displaylogo: false, scrollZoom: false, modeBarButtonsToRemove: ["lasso2d", "select2d"] };

  function colours() {
    const style = getComputedStyle(document.documentElement);
    const of = (name) => style.getPropertyValue(name).trim();
    return { text: of("--text"), soft: of("--soft"), grid: of("--grid"), rule: of("--rule"), panel: of("--panel") };
  }

  function themed(layout, height) {
    const c = colours();
    const axis = { gridcolor: c.grid, linecolor: c.rule, zerolinecolor: c.rule, tickcolor: c.rule, automargin: true };
    const result = Object.assign(
      {
        font: { color: c.text, size: 12, family: "system-ui, -apple-system, 'Segoe UI', Arial, sans-serif" },
        paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)", height,
        margin: { l: 56, r: 16, t: 16, b: 44 }, hoverlabel: { namelength: -1 }, uirevision: "kept",
        legend: { orientation: "h", y: 1.02, yanchor: "bottom", x: 0 },
      },
      layout,
    );
    for (const key of Object.keys(result)) {
      if (/^[xy]axis\d*$/.test(key)) result[key] = Object.assign({}, axis, result[key]);
    }
    if (result.polar) {
      result.polar = Object.assign({}, result.polar, { bgcolor: "rgba(0,0,0,0)" });
      for (const key of ["radialaxis", "angularaxis"]) {
        result.polar[key] = Object.assign({}, { gridcolor: c.grid, linecolor: c.rule, tickcolor: c.rule }, result.polar[key]);
      }
    }
    if (result.scene) {
      result.scene = Object.assign({}, result.scene);
      for (const key of ["xaxis", "yaxis", "zaxis"]) {
        result.scene[key] = Object.assign(
          { gridcolor: c.rule, zerolinecolor: c.rule, linecolor: c.rule, showbackground: false, color: c.soft },
          result.scene[key],
        );
      }
    }
    if (window.innerWidth < 700 && result.legend.orientation === "v") {
      result.legend = Object.assign({}, result.legend, { orientation: "h", x: 0, y: -0.3, yanchor: "top" });
    }
    return result;
  }

  function traces(plot) {
    const text = colours().text;
    return plot.data.map((trace) => {
      const copy = Object.assign({}, trace);
      if (copy.line && copy.line.color === "currentColor") copy.line = Object.assign({}, copy.line, { color: text });
      if (copy.meta && copy.meta.uav !== undefined) copy.visible = !hidden.has(copy.meta.uav);
      return copy;
    });
  }

  function draw(node) {
    const plot = content.plots[node.dataset.plot];
    const isNew = !drawn.has(node);
    drawn.set(node, plot);
    Plotly.react(node, traces(plot), themed(plot.layout, node.clientHeight), config);
    if (isNew && plot.time && replay) node.on("plotly_click", (event) => replay.seek(clickedTime(node, event)));
  }

  function clickedTime(node, event) {
    const point = event.points[0];
    if (point.data.type !== "bar") return point.x;
    const axis = point.xaxis; // a bar has the time of its end as x
    return axis.p2c(event.event.clientX - node.getBoundingClientRect().left - axis._offset);
  }

  function drawAll() {
    for (const node of document.querySelectorAll(".graph[data-plot]")) if (!drawn.has(node)) draw(node);
  }

  function unpack(packed) {
    const kinds = { f4: Float32Array, f8: Float64Array, i1: Int8Array, u1: Uint8Array, i2: Int16Array, u2: Uint16Array, i4: Int32Array, u4: Uint32Array };
    const text = atob(packed.bdata);
    const bytes = new Uint8Array(text.length);
    for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
    return new kinds[packed.dtype](bytes.buffer);
  }

  function makeReplay(data, node) {
    const slider = document.getElementById("replay-time");
    const clock = document.getElementById("replay-clock");
    const button = document.getElementById("replay-play");
    const speed = document.getElementById("replay-speed");
    const trail = document.getElementById("replay-trail");
    const n = data.vehicles;
    const time = unpack(data.time);
    const pos = unpack(data.pos);
    const places = unpack(data.places);
    const believed = data.believed ? unpack(data.believed) : null;
    const alive = unpack(data.alive);
    const links = {};
    for (const key of Object.keys(data.links)) links[key] = unpack(data.links[key]);
    const last = time.length - 1;
    const tags = Array.from({ length: n }, (_, i) => String(i));
    let instant = 0;
    let playing = null;
    let isDrawn = false;
    slider.max = String(last);

    const at = (values, k, i) => [values[(k * n + i) * 3], values[(k * n + i) * 3 + 1], values[(k * n + i) * 3 + 2]];
    const points = () => ({ x: [], y: [], z: [], text: [], colour: [], size: [] });
    const push = (to, p) => { to.x.push(p[0]); to.y.push(p[1]); to.z.push(p[2]); };
    const gap = (to) => { to.x.push(null); to.y.push(null); to.z.push(null); };

    function frame(k) {
      const found = { trail: points(), ranged: points(), failed: points(), sent: points(), unsent: points(),
                      places: points(), believed: points(), lostFrames: points(), living: points(), lost: points() };
      const span = Number(trail.value);
      let first = k;
      while (first > 0 && time[k] - time[first - 1] <= span) first--;
      const stride = Math.max(1, Math.ceil(((k - first + 1) * n) / 12000));
      for (let i = 0; i < n; i++) {
        if (hidden.has(i)) continue;
        const isAlive = alive[k * n + i];
        const here = at(pos, k, i);
        const to = isAlive ? found.living : found.lost;
        push(to, here);
        to.text.push(tags[i]);
        to.colour.push(data.colours[i]);
        push(found.places, data.places_fixed ? at(places, 0, i) : at(places, k, i));
        if (believed && isAlive) push(found.believed, at(believed, k, i));
        if (isAlive && links.lost[k * n + i]) {
          push(found.lostFrames, here);
          found.lostFrames.size.push(12 + (26 * links.lost[k * n + i]) / 255);
        }
        if (span > 0) {
          for (let j = first + ((k - first) % stride); j <= k; j += stride) {
            if (alive[j * n + i]) { push(found.trail, at(pos, j, i)); found.trail.colour.push(data.colours[i]); }
          }
          gap(found.trail);
          found.trail.colour.push(data.colours[i]);
        }
      }
      for (let l = links.starts[k]; l < links.starts[k + 1]; l++) {
        const a = links.first[l];
        const b = links.second[l];
        if (hidden.has(a) || hidden.has(b)) continue;
        const to = [found.ranged, found.failed, found.sent, found.unsent][links.state[l]];
        push(to, at(pos, k, a));
        push(to, at(pos, k, b));
        gap(to);
      }
      return found;
    }

    function data3d(k) {
      const f = frame(k);
      const xyz = (p) => ({ x: p.x, y: p.y, z: p.z });
      const lines = (p, name, colour, width, dash) =>
        Object.assign({ type: "scatter3d", mode: "lines", name, hoverinfo: "skip", line: { color: colour, width, dash } }, xyz(p));
      const c = colours();
      const hover = "UAV %{text}<br>east %{x:.2f} m, north %{y:.2f} m, up %{z:.2f} m<extra></extra>";
      return [
        Object.assign({ type: "scatter3d", mode: "lines", name: "trail", hoverinfo: "skip", showlegend: false,
                        line: { color: f.trail.colour.length ? f.trail.colour : c.soft, width: 3 }, opacity: 0.55 }, xyz(f.trail)),
        lines(f.ranged, "ranged", "#2f9e62", 3, "solid"),
        lines(f.failed, "ranging failed", "#d64545", 5, "solid"),
        lines(f.sent, "datagram delivered", "#4c78a8", 3, "solid"),
        lines(f.unsent, "datagram lost", "#f58518", 5, "solid"),
        Object.assign({ type: "scatter3d", mode: "markers", name: "desired place", hoverinfo: "skip",
                        marker: { symbol: "cross", size: 4, color: c.soft } }, xyz(f.places)),
        Object.assign({ type: "scatter3d", mode: "markers", name: "believed position", hoverinfo: "skip",
                        visible: believed ? true : false,
                        marker: { symbol: "circle-open", size: 9, color: c.text } }, xyz(f.believed)),
        Object.assign({ type: "scatter3d", mode: "markers", name: "its broadcasts were lost by some", hoverinfo: "skip",
                        marker: { symbol: "circle", size: f.lostFrames.size, color: "#d64545", opacity: 0.25, line: { width: 0 } } }, xyz(f.lostFrames)),
        Object.assign({ type: "scatter3d", mode: n <= 24 ? "markers+text" : "markers", name: "UAV", text: f.living.text,
                        textposition: "top center", hovertemplate: hover, textfont: { color: c.text, size: 12 },
                        marker: { size: 6, color: f.living.colour.length ? f.living.colour : c.text, line: { width: 1, color: c.panel } } }, xyz(f.living)),
        Object.assign({ type: "scatter3d", mode: "markers+text", name: "lost", text: f.lost.text, textposition: "top center",
                        hovertemplate: hover, textfont: { color: c.text, size: 12 }, showlegend: f.lost.x.length > 0,
                        marker: { symbol: "diamond", size: 7, color: "#d64545" } }, xyz(f.lost)),
      ];
    }

    function layout() {
      const [x, y, z] = data.range;
      const title = (text) => ({ title: { text } });
      const far = Math.max(1, Math.hypot(...data.aspect) / Math.sqrt(3));
      return themed({
        margin: { l: 0, r: 0, t: 0, b: 0 },
        scene: {
          xaxis: Object.assign(title("East (m)"), { range: x }),
          yaxis: Object.assign(title("North (m)"), { range: y }),
          zaxis: Object.assign(title("Up (m)"), { range: z }),
          aspectmode: "manual", aspectratio: { x: data.aspect[0], y: data.aspect[1], z: data.aspect[2] },
          camera: { eye: { x: -1.25 * far, y: -1.45 * far, z: 0.9 * far }, center: { x: 0, y: 0, z: -0.12 } }, uirevision: "kept",
        },
        legend: { orientation: "h", y: 1, yanchor: "top", x: 0, bgcolor: "rgba(0,0,0,0)" },
      }, node.clientHeight);
    }

    function show(k) {
      instant = Math.max(0, Math.min(last, k));
      slider.value = String(instant);
      clock.textContent = `t = ${time[instant].toFixed(2)} s`;
      if (isDrawn) Plotly.react(node, data3d(instant), layout(), config);
    }

    function seek(seconds) {
      let low = 0;
      let high = last;
      while (low < high) {
        const middle = (low + high) >> 1;
        if (time[middle] < seconds) low = middle + 1; else high = middle;
      }
      show(low);
    }

    function stop() {
      if (playing !== null) cancelAnimationFrame(playing);
      playing = null;
      button.textContent = "▶";
      button.setAttribute("aria-label", "Play");
    }

    function play() {
      if (instant >= last) show(0);
      let before = null;
      let simulated = time[instant];
      const step = (now) => {
        if (before !== null) simulated += ((now - before) / 1000) * Number(speed.value);
        before = now;
        let k = instant;
        while (k < last && time[k + 1] <= simulated) k++;
        if (k !== instant) show(k);
        if (instant >= last) stop(); else playing = requestAnimationFrame(step);
      };
      button.textContent = "❚❚";
      button.setAttribute("aria-label", "Pause");
      playing = requestAnimationFrame(step);
    }

    slider.addEventListener("input", () => { stop(); show(Number(slider.value)); });
    trail.addEventListener("change", () => show(instant));
    button.addEventListener("click", () => (playing === null ? play() : stop()));
    show(Math.round(last / 2));
    return {
      draw() { isDrawn = true; show(instant); },
      redraw() { show(instant); },
      seek,
    };
  }

  const scene = document.getElementById("replay");
  const replay = content.replay && scene ? makeReplay(content.replay, scene) : null;

  const chips = document.getElementById("chips");
  function showVehicles() {
    chips.querySelectorAll("button[data-uav]").forEach((button) => {
      button.setAttribute("aria-pressed", String(!hidden.has(Number(button.dataset.uav))));
    });
    for (const node of drawn.keys()) draw(node);
    if (replay) replay.redraw();
  }
  if (content.vehicles.length > 1) {
    const all = document.createElement("button");
    all.type = "button";
    all.textContent = "all";
    all.addEventListener("click", () => { hidden.clear(); showVehicles(); });
    chips.append(all);
    content.vehicles.forEach((colour, i) => {
      const button = document.createElement("button");
      const dot = document.createElement("i");
      button.type = "button";
      button.dataset.uav = String(i);
      button.title = "Show or hide; double click: this one alone";
      button.setAttribute("aria-pressed", "true");
      dot.style.background = colour;
      button.append(dot, `UAV ${i}`);
      button.addEventListener("click", () => { if (!hidden.delete(i)) hidden.add(i); showVehicles(); });
      button.addEventListener("dblclick", () => {
        hidden.clear();
        content.vehicles.forEach((_, k) => { if (k !== i) hidden.add(k); });
        showVehicles();
      });
      chips.append(button);
    });
  }

  const nearby = new IntersectionObserver((entries) => {
    for (const entry of entries) {
      if (!entry.isIntersecting) continue;
      nearby.unobserve(entry.target);
      if (entry.target === scene) replay.draw(); else draw(entry.target);
    }
  }, { rootMargin: "600px 0px" });
  for (const node of document.querySelectorAll(".graph")) if (node !== scene || replay) nearby.observe(node);

  dark.addEventListener("change", () => showVehicles());
  window.addEventListener("beforeprint", drawAll);
})();
