"""The web page of ``viewer/html.py``: markup and style; what stands between two @ is filled in.

The root element tells its state in data attributes (``data-ready``, ``data-seconds`` until then,
``data-frame``, ``data-drawn``, ``data-columns`` of panes, ``data-error``),
for whoever watches the page from outside.
"""

PAGE = r"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<link rel="icon" href="data:,">
<title>@NAME@: @ABOUT@</title>
<style>
html, body { margin: 0; height: 100%; background: #fff; color: #20242c; font: 14px system-ui, sans-serif; }
body { display: flex; flex-direction: column; }
#view { flex: 1; min-height: 0; position: relative; }
canvas { position: absolute; width: 100%; height: 100%; touch-action: none; cursor: grab; }
#about { padding: 6px 12px 0; color: #5a6372; font-size: 12px;
  white-space: nowrap; overflow: hidden; text-overflow: ellipsis; }
#about b { color: #20242c; font-size: 14px; }
#titles div { position: absolute; padding: 8px 12px; box-sizing: border-box; font-weight: 600; pointer-events: none;
  white-space: nowrap; overflow: hidden; text-overflow: ellipsis; }
#bar { align-self: center; width: min(420px, 80%); padding-bottom: 6px; text-align: center; font-size: 12px; }
#bar canvas { position: static; display: block; width: 100%; height: 12px; }
#ticks { position: relative; height: 16px; }
#ticks span { position: absolute; white-space: nowrap; transform: translateX(-50%); }
#ends { color: #5a6372; }
#controls { display: flex; flex-wrap: wrap; gap: 10px; align-items: center; padding: 8px 12px; background: #f1f3f6; }
#controls input[type=range] { flex: 1; min-width: 120px; }
button, select { font: inherit; padding: 2px 10px; }
#name { min-width: 9em; font-variant-numeric: tabular-nums; overflow-wrap: anywhere; }
#message { position: absolute; inset: 40% 10% auto; text-align: center; }
@media (max-width: 600px) { #controls { gap: 4px 8px; padding: 6px; font-size: 12px; } }
[hidden] { display: none !important; }
</style>
</head>
<body>
<div id="about"><b>@NAME@</b> @ABOUT@</div>
<div id="view">
<canvas id="canvas"></canvas>
<div id="titles"></div>
<p id="message" hidden></p>
</div>
<div id="bar" hidden><span id="label"></span><canvas id="ramp" width="255" height="1"></canvas>
<div id="ticks"></div><span id="ends"></span></div>
<div id="controls">
<button id="play" title="space">play</button>
<input id="slider" type="range" min="0" value="0" step="1" aria-label="frame">
<span id="name"></span>
<label>speed <select id="speed"><option>0.1</option><option>0.25</option><option>0.5</option>
<option selected>1</option><option>2</option><option>4</option></select></label>
<label title="l"><input id="loop" type="checkbox" checked> loop</label>
<label title="between frames"><input id="blend" type="checkbox" checked> smooth motion</label>
<label title="s"><input id="smooth" type="checkbox"> smooth shading</label>
<label title="w"><input id="wire" type="checkbox"> edges</label>
<label title="p" id="cloudLabel"><input id="cloud" type="checkbox"> cloud</label>
<button id="home" title="r">camera</button>
</div>
<script id="scene" type="application/json">@SCENE@</script>
<script>
@SCRIPT@</script>
</body>
</html>
"""
