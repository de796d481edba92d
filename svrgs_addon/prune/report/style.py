"""The style sheet of the report page, and its script, which wipes between original and pruned picture."""

CSS = """
:root { color-scheme: light dark; --page: #f6f5f2; --card: #fff; --text: #1d1f23; --soft: #62666e; --line: #dcdad4;
  --accent: #b5441f; --good: #1b7340; --bad: #b3261e; }
@media (prefers-color-scheme: dark) { :root { --page: #16171a; --card: #1f2125; --text: #e8e6e1; --soft: #9fa3ab;
  --line: #34373d; --accent: #f19a6b; --good: #6cc58c; --bad: #f28b82; } }
* { box-sizing: border-box; }
body { margin: 0 auto; max-width: 1500px; padding: 2rem clamp(1rem, 3vw, 3rem);
  background: var(--page); color: var(--text);
  font: 16px/1.5 system-ui, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif; }
h1 { font-size: 1.9rem; line-height: 1.2; margin: 0; overflow-wrap: anywhere; }
h2 { font-size: 1.2rem; margin: 2.5rem 0 .8rem; }
h3 { font-size: 1rem; margin: 0; overflow-wrap: anywhere; }
p { margin: .4rem 0; max-width: 75ch; }
.soft, figcaption, dt { color: var(--soft); } .note { color: var(--accent); }
.card { background: var(--card); border: 1px solid var(--line); border-radius: 10px; padding: 1rem 1.2rem; }
.columns { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(100%, 24rem), 1fr));
  gap: 1rem 1.5rem; align-items: start; }
.columns > * { min-width: 0; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; width: 100%; font-variant-numeric: tabular-nums; }
th, td { padding: .45rem .6rem; text-align: right; border-bottom: 1px solid var(--line); }
th:first-child, td:first-child { text-align: left; }
thead th { color: var(--soft); font-weight: 600; overflow-wrap: anywhere; }
tbody th { font-weight: 500; }
tbody tr:last-child > * { border-bottom: 0; }
.good { color: var(--good); } .bad { color: var(--bad); }
dl { display: grid; grid-template-columns: max-content 1fr; gap: .3rem 1.2rem; margin: 0;
  font-variant-numeric: tabular-nums; }
dd { margin: 0; overflow-wrap: anywhere; }
figure { margin: 0; }
svg { display: block; width: 100%; height: auto; font: 12px system-ui, sans-serif; }
svg .grid { stroke: var(--line); } svg .axis { stroke: var(--soft); }
svg .tick { fill: var(--soft); } svg .phase { fill: var(--text); }
svg .mark { stroke: var(--soft); stroke-dasharray: 4 4; }
svg .curve { fill: none; stroke: var(--accent); stroke-width: 2; stroke-linejoin: round; }
svg .dot { fill: var(--accent); }
.view { margin-bottom: 1rem; }
.view header { display: flex; flex-wrap: wrap; gap: .2rem 1.2rem; align-items: baseline; margin-bottom: .7rem; }
.pictures { --share: calc((100% - (var(--across) - 1) * .8rem) / var(--across)); display: grid; gap: .8rem;
  grid-template-columns: repeat(auto-fill, minmax(min(100%, max(15rem, var(--share))), 1fr)); }
.pictures img { display: block; width: 100%; height: auto; border-radius: 4px; }
.stack { background-size: 100% 100%; border-radius: 4px; overflow: hidden; touch-action: pan-y; }
.stack.live { cursor: ew-resize; }
figcaption { font-size: .88rem; padding-top: .3rem; }
.swing { max-width: 56rem; border-radius: 4px; animation: swing 1.6s infinite alternate; }
@keyframes swing { to { background-position-x: 100%; } }
@media (prefers-reduced-motion: reduce) { .swing { animation: none; } }
.bar { height: .55rem; border-radius: 3px; margin-top: .45rem; border: 1px solid var(--line); }
.range { display: flex; font-size: .88rem; justify-content: space-between; font-variant-numeric: tabular-nums; }
footer { margin-top: 2.5rem; font-size: .88rem; color: var(--soft); }
@media print { body { background: #fff; } .card { break-inside: avoid; } }
"""

# In a .stack, the pruned picture covers the original, its background image. The script clips it at the
# position of the pointer.
SCRIPT = """
for (const view of document.querySelectorAll(".view")) {
  const below = view.querySelector(".original img"), stack = view.querySelector(".stack");
  const above = stack.querySelector("img");
  stack.style.backgroundImage = `url(${below.src})`;
  stack.classList.add("live");
  stack.addEventListener("pointermove", event => {
    const box = stack.getBoundingClientRect();
    above.style.clipPath = `inset(0 0 0 ${event.clientX - box.left}px)`;
  });
  stack.addEventListener("pointerleave", () => { above.style.clipPath = ""; });
}
"""
