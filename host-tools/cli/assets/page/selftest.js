// Result of a self-test as a picture: one cell for each channel, the taxels in their places.
import { made } from "./store.js";

/** Kind of a channel's cell, and its word. */
const judged = ({ fault, noisy }) => (!fault ? ["sound", ""] : noisy ? ["noisy", "≈ "] : ["faulty", "✗ "]);

function cell(channel, full) {
  const [kind, mark] = judged(channel);
  const box = made("div", `channel ${kind}`);
  box.dataset.name = channel.name;
  box.title = channel.fault ?? `${channel.name}: mean ${channel.mean.toFixed(0)} codes, noise ${channel.noise.toFixed(1)} codes`;
  box.append(made("b", "", `${(100 * channel.mean / full).toFixed(0)} %`), made("small", "", mark + channel.name.replace(/^(lit|dark|bridge_s\d)_/, "")));
  return box;
}

/** Shows the result; null hides the picture. */
export function selfTest(panel, result, taxels) {
  panel.hidden = !result;
  if (!result) return;
  const { channels, others, full_scale: full } = result;
  const named = Object.fromEntries(channels.map((channel) => [channel.name, channel]));
  const wrong = channels.filter(({ fault }) => fault);
  const noisy = wrong.filter((channel) => channel.noisy);
  const faults = [...wrong.filter((channel) => !channel.noisy).map(({ fault }) => fault), ...others];
  const body = panel.querySelector(".picture");
  const group = (title, names) => {
    const there = names.filter((name) => name in named);
    if (!there.length) return;
    const grid = made("div", "channels");
    grid.append(...there.map((name) => cell(named[name], full)));
    body.append(made("h3", "", title), grid);
  };
  body.replaceChildren();
  // The taxels lie as on the picture of the finger, seen from outside: y upwards.
  const order = taxels.map(([x, y], k) => [-y, x, k]).sort((a, b) => a[0] - b[0] || a[1] - b[1]);
  group("Taxels, lit", order.map(([, , k]) => `lit_r${k >> 2}c${k & 3}`));
  group("Columns in the dark", [0, 1, 2, 3].map((c) => `dark_c${c}`));
  for (let s = 0; s < 4; s++) group(`Force sensor ${s}`, [..."abcd"].map((m) => `bridge_s${s}_${m}`));
  const sum = panel.querySelector(".sum");
  sum.textContent = wrong.length + others.length ? `${channels.length - wrong.length} of ${channels.length} sound` : `all ${channels.length} sound`;
  sum.className = `sum ${faults.length ? "bad" : wrong.length ? "warn" : "good"}`;
  const list = panel.querySelector("ul");
  const said = faults.slice(0, 3);
  if (faults.length > 3) said.push(`and ${faults.length - 3} more: point at a cell`);
  if (noisy.length) said.push(noisy.length > 3 ? `${noisy.length} channels are noisy: let go of the finger, keep it still and shaded, and test again` : noisy.map(({ fault }) => fault).join("; "));
  list.replaceChildren(...said.map((text) => made("li", "", text)));
}
