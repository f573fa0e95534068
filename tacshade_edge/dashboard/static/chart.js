// Chart of the greatest depth over the last minute, with marks where something slipped.

import { roundTicks } from "./scale.js";
import uPlot from "./vendor/uPlot.esm.js";

const ENDS_MM = [0.5, 1, 2, 3, 4, 5, 6, 8, 10, 15, 20, 40];
const SPAN_S = 60, PERIOD_MS = 150, GAP_S = 1;

export class DepthChart {
  constructor() {
    this.host = document.getElementById("chart");
    this.clear();
    new ResizeObserver(() => this.resize()).observe(this.host);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.build());
  }

  clear() {
    this.times = [];
    this.depths = [];
    this.slips = []; // depth where something slipped, else null
    this.build();
  }

  /** Add a value at its time of arrival: the sensor's clock differs from this machine's. */
  add(depth_mm, slips) {
    const now = performance.now() / 1000, last = this.times.at(-1);
    if (last !== undefined && now - last > GAP_S) {
      this.times.push(last + GAP_S / 2);
      this.depths.push(null); // nothing was received: no line
      this.slips.push(null);
    }
    this.times.push(now);
    this.depths.push(depth_mm);
    this.slips.push(slips ? depth_mm : null);
    let old = 0;
    while (this.times[old] < now - SPAN_S) old++;
    if (old > 200) {
      this.times.splice(0, old);
      this.depths.splice(0, old);
      this.slips.splice(0, old);
    }
    this.timer ||= setTimeout(() => this.draw(), PERIOD_MS);
  }

  draw() {
    clearTimeout(this.timer);
    this.timer = 0;
    const now = performance.now() / 1000;
    this.plot.setData([this.times.map((time) => time - now), this.depths, this.slips], false);
    this.plot.setScale("x", { min: -SPAN_S, max: 0 });
  }

  build() {
    this.plot?.destroy();
    const style = getComputedStyle(document.documentElement), colour = (name) => style.getPropertyValue(name).trim();
    const axis = { stroke: colour("--quiet"), grid: { stroke: colour("--line"), width: 1 }, ticks: { show: false }, font: "12px system-ui, sans-serif" };
    this.plot = new uPlot({
      width: Math.max(this.host.clientWidth, 100),
      height: Math.max(this.host.clientHeight, 100),
      legend: { show: false },
      cursor: { show: false },
      scales: { x: { time: false }, y: { range: (_plot, _low, high) => [0, ENDS_MM.find((end) => end >= (high ?? 0)) ?? high] } },
      axes: [
        { ...axis, size: 28, splits: () => [-60, -45, -30, -15, 0], values: (_plot, ticks) => ticks.map((tick) => (tick === 0 ? "now" : `−${-tick} s`)) },
        { ...axis, size: 40, splits: (_plot, _axis, low, high) => roundTicks(low, high) },
      ],
      series: [
        {},
        { stroke: colour("--accent"), width: 1.5, points: { show: false } },
        { stroke: colour("--bad"), width: 0, points: { show: true, size: 6, fill: colour("--bad") } },
      ],
    }, [[], [], []], this.host);
    this.draw();
  }

  resize() {
    const { clientWidth: width, clientHeight: height } = this.host;
    if (width && height) this.plot.setSize({ width, height });
  }
}
