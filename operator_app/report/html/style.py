"""The style sheet of a report: screen, phone and paper, light and dark. Knows no content.

Normal is grey; colour marks the abnormal and separates series, always together with another sign.
"""

from __future__ import annotations

from operator_app.report.parameter_tables import HEAT_STEPS

LIGHT = {
    "page": "#ffffff",
    "panel": "#f4f6f8",
    "text": "#1c2126",
    "muted": "#56606b",
    "rule": "#d5dae0",
    "accent": "#0b5c9e",
    "second": "#a34700",
    "third": "#5b5f66",
    "good": "#1f6b3a",
    "bad": "#a8202a",
    "warn": "#7f5200",
    "band": "#dfe8f1",
    "shade": "rgb(28 33 38/.22)",
    "plus": "11 92 158",
    "minus": "176 84 0",
}
DARK = {
    "page": "#14171b",
    "panel": "#1d2126",
    "text": "#e2e6ea",
    "muted": "#9ca6b1",
    "rule": "#343a42",
    "accent": "#6fb3ee",
    "second": "#f0a35e",
    "third": "#b4bac2",
    "good": "#7ccb95",
    "bad": "#ff8d8a",
    "warn": "#e3b04b",
    "band": "#263442",
    "shade": "rgb(0 0 0/.75)",
    "plus": "111 179 238",
    "minus": "240 163 94",
}
HEAT_ALPHA = 0.09
"""Opacity of a cell of the heat table: this much a step."""


def _variables(colours: dict[str, str]) -> str:
    return "".join(f"--{name}:{value};" for name, value in colours.items())


_HEAT = "".join(
    f".{name}{k}{{background:rgb(var(--{name})/{HEAT_ALPHA * k:.2f})}}"
    for name in ("plus", "minus")
    for k in range(1, HEAT_STEPS + 1)
)

PLOT_RULES = """svg text{fill:var(--muted)}
svg .axis,svg .legend{fill:var(--text)}
.grid{stroke:var(--rule);stroke-width:.7}
.zero{stroke:var(--muted);stroke-width:.8}
.frame{stroke:var(--muted);stroke-width:.8}
.band{fill:var(--band)}
.ribbon{fill:var(--second);fill-opacity:.28}
.range{fill:none;stroke:var(--muted);stroke-width:.8}
.rug{stroke:var(--accent);stroke-width:.7;stroke-opacity:.75}
.line{fill:none;stroke-width:1.4}
.line.a{stroke:var(--accent)}.line.b{stroke:var(--second)}
.line.gap{stroke:var(--bad);stroke-width:2}
.line.dashed{stroke:var(--muted);stroke-dasharray:4 3}
.stem{stroke-width:.8;stroke-opacity:.6}.stem.a{stroke:var(--accent)}.stem.c{stroke:var(--second)}
.mark.a{fill:var(--accent)}
.mark.b{fill:none;stroke:var(--second);stroke-width:1.2}
.mark.c{fill:var(--second)}
.mark.d{fill:var(--third)}
"""
"""Style of the content of a picture."""

STYLE = f"""
:root{{color-scheme:light dark;{_variables(LIGHT)}}}
@media (prefers-color-scheme:dark){{:root{{{_variables(DARK)}}}}}
*{{box-sizing:border-box}}
html{{-webkit-text-size-adjust:100%;text-size-adjust:100%}}
body{{margin:0;background:var(--page);color:var(--text);
 font:15px/1.45 system-ui,-apple-system,"Segoe UI",Roboto,"Noto Sans","DejaVu Sans",sans-serif;
 font-variant-numeric:tabular-nums lining-nums}}
main,header,footer{{max-width:1760px;margin:0 auto;padding:0 20px}}
header{{padding-top:20px}}
h1{{font-size:1.65rem;line-height:1.2;margin:0;font-weight:650}}
h2{{font-size:1.1rem;margin:34px 0 6px;padding-top:10px;border-top:1px solid var(--rule);font-weight:650}}
h3{{font-size:.95rem;margin:18px 0 4px;font-weight:650}}
p{{margin:6px 0;max-width:120ch}}
ul{{margin:6px 0;padding-left:1.2em;max-width:124ch}}
.summary{{display:grid;grid-template-columns:minmax(0,2fr) minmax(0,3fr);gap:0 34px}}
.summary h2{{border:0;margin:10px 0 2px;padding:0}}
.summary>div:only-child{{grid-column:1/-1}}
.summary .plots{{grid-template-columns:1fr 1fr;margin:4px 0}}
main{{display:grid;grid-template-columns:repeat(2,minmax(0,1fr));gap:0 34px;grid-auto-flow:row dense}}
section{{grid-column:1/-1;min-width:0}}
section.narrow{{grid-column:auto}}
li{{margin:3px 0}}
a{{color:var(--accent)}}
a:focus-visible,.scroll:focus-visible{{outline:2px solid var(--accent);outline-offset:2px}}
code,.mono,table.parameters tbody th,
table.correlations tbody th{{font-size:.92em;
 font-family:ui-monospace,"SF Mono","Cascadia Mono","DejaVu Sans Mono",Menlo,monospace}}
.muted,.unit,caption,figcaption{{color:var(--muted)}}
.unit{{font-weight:400;white-space:nowrap}}
.skip{{position:absolute;left:-999px}}
.skip:focus{{left:8px;top:8px;background:var(--page);padding:6px}}
.verdict{{border-left:6px solid var(--good);padding:2px 0 2px 14px;margin:0 0 12px}}
.verdict.no{{border-color:var(--bad)}}
.verdict .glyph{{color:var(--good)}}
.verdict.no .glyph{{color:var(--bad)}}
.verdict p{{margin:3px 0 0}}
.simulated{{display:inline-block;border:1px solid var(--warn);color:var(--warn);border-radius:3px;
 padding:1px 8px;font-size:.85rem;font-weight:600;margin:0 0 10px}}
.tiles{{display:grid;grid-template-columns:repeat(auto-fit,minmax(152px,1fr));gap:1px;margin:14px 0;
 background:var(--rule);border:1px solid var(--rule)}}
.tiles div{{background:var(--page);padding:8px 12px}}
.tiles dt{{color:var(--muted);font-size:.8rem}}
.tiles dd{{margin:0;font-size:1.3rem;font-weight:600;line-height:1.3}}
.tiles dd .unit{{font-size:.85rem}}
.tiles dd.was{{font-size:.8rem;font-weight:400;color:var(--muted)}}
dl.facts{{display:grid;grid-template-columns:repeat(2,max-content minmax(0,1fr));gap:2px 18px;margin:8px 0}}
dl.facts dt{{color:var(--muted)}}
dl.facts dd{{margin:0;overflow-wrap:anywhere}}
nav{{font-size:.88rem;margin:10px 0 0}}
nav ul{{list-style:none;display:flex;flex-wrap:wrap;gap:2px 16px;padding:0;max-width:none}}
ul.warnings{{list-style:none;padding:0;max-width:none;display:grid;gap:0 34px;
 grid-template-columns:repeat(auto-fit,minmax(min(100%,480px),1fr))}}
ul.warnings li{{border-left:3px solid var(--warn);padding:2px 0 2px 12px;margin:8px 0}}
ul.warnings.notes li{{border-color:var(--rule)}}
ul.warnings.notes .glyph{{color:var(--muted)}}
ul.warnings:not(.notes) .glyph,.warn{{color:var(--warn)}}
.scroll{{overflow-x:auto;margin:10px 0;
 background:linear-gradient(to right,var(--page) 35%,transparent) left/44px 100% no-repeat local,
 linear-gradient(to left,var(--page) 35%,transparent) right/44px 100% no-repeat local,
 linear-gradient(to right,var(--shade),transparent) left/11px 100% no-repeat,
 linear-gradient(to left,var(--shade),transparent) right/11px 100% no-repeat}}
table{{border-collapse:collapse;font-size:.88rem;line-height:1.3}}
caption{{text-align:left;font-size:.85rem;padding:2px 0 5px}}
caption span{{display:inline-block;position:sticky;left:0;max-width:calc(100vw - 30px)}}
.whole{{white-space:nowrap}}
th,td{{padding:3px 9px;border-bottom:1px solid var(--rule);text-align:left;white-space:nowrap;font-weight:400}}
thead th{{font-weight:600;white-space:normal;min-width:4.2em;vertical-align:bottom;border-bottom-color:var(--muted)}}
thead th.group{{text-align:center;color:var(--muted);font-weight:600}}
.n{{text-align:right}}
.start{{padding-left:24px}}
tbody th{{position:sticky;left:0;background:var(--page)}}
tbody tr:hover>*{{background:var(--panel)}}
.remark{{display:block;white-space:normal;min-width:13em;max-width:40em;overflow-wrap:anywhere}}
tr.out>*{{color:var(--muted)}}
.found{{font-weight:600}}
table.pose-table th,table.pose-table td,table.budget th,table.budget td{{padding:3px 6px}}
table.correlations td{{text-align:right;padding:2px 5px;font-size:.8rem}}
table.correlations th{{padding:2px 6px;font-size:.8rem}}
table.correlations thead th{{min-width:0;white-space:nowrap;
 writing-mode:vertical-rl;transform:rotate(180deg);text-align:left;padding:6px 2px}}
table.correlations thead th:first-child{{writing-mode:horizontal-tb;transform:none}}
{_HEAT}
.plots{{display:grid;
 grid-template-columns:repeat(auto-fit,minmax(min(100%,330px),470px));gap:12px 26px;margin:10px 0}}
figure{{margin:0;max-width:470px}}
figcaption{{font-size:.85rem;margin:0 0 2px}}
figcaption b{{color:var(--text);font-weight:600}}
svg.plot{{display:block;width:100%;height:auto;font-size:9.6px}}
{PLOT_RULES}footer{{margin:36px auto 30px;color:var(--muted);font-size:.85rem}}
@media (max-width:900px){{
 main,.summary{{display:block}}
 dl.facts{{grid-template-columns:max-content minmax(0,1fr)}}
}}
@media (max-width:560px){{
 body{{font-size:14.5px}}
 main,header,footer{{padding-left:14px;padding-right:14px}}
 h1{{font-size:1.4rem}}
 svg.plot{{font-size:11px}}
 dl.facts{{grid-template-columns:1fr;gap:0}}
 dl.facts dd{{margin-bottom:5px}}
 th,td{{padding:3px 5px}}
 td:not(.n),tbody th{{white-space:normal}}
 tbody th{{min-width:5.5em}}
 .remark{{min-width:0}}
}}
@media print{{
 @page{{size:A4;margin:13mm 12mm}}
 :root{{color-scheme:light;{_variables(LIGHT)}}}
 html{{font-size:11.5px}}
 body{{font-size:9pt;-webkit-print-color-adjust:exact;print-color-adjust:exact}}
 main,header,footer{{max-width:none;padding:0}}
 main{{display:block}}
 dl.facts{{grid-template-columns:repeat(2,max-content minmax(0,1fr))}}
 .summary{{gap:0 18px}}
 nav,.skip{{display:none}}
 h2{{margin-top:14px}}
 h2,h3,caption,tbody tr:nth-child(-n+2){{break-after:avoid}}
 table{{font-size:7.4pt}}
 th,td{{padding:1.5px 5px}}
 table.correlations td,table.correlations th{{font-size:6.4pt;padding:1.5px 2.5px}}
 thead{{display:table-header-group}}
 table.correlations,tr,figure,.tiles,.verdict,li,dl.facts{{break-inside:avoid}}
 .scroll{{overflow:visible;margin:6px 0;background:none}}
 .scroll:not(:has(.pose-table)){{break-inside:avoid}}
 .plots{{grid-template-columns:1fr 1fr;gap:8px 18px}}
 .tiles{{grid-template-columns:repeat(6,1fr)}}
 .tiles dd{{font-size:12pt}}
 a{{color:inherit;text-decoration:none}}
}}
"""
