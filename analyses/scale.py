"""What would an archive of a million captures cost on a hundred machines?

Data: `reports/scale.json`, rates measured by ``python tests/benchmarks/archive_scale.py -o reports/scale.json``, and
`reports/faults.json`, what runs survived (``python tests/batch/fault_campaign.py -o reports/faults.json``).
Result: `reports/scale.html`.  Run time: a second.
"""

# %%
import base64
import json
from pathlib import Path

from jinja2 import Environment
from matplotlib.figure import Figure

from isetval.app.plots.panels import figure_bytes

REPORTS = Path(__file__).resolve().parents[1] / "reports"
CAPTURES, MACHINES, WORKERS = 1_000_000, 100, 8
NETWORK_MB_S = 110.0  # of one machine: a gigabit line, stated and not measured
TASK_FILES, TASK_MS = 32, 3.5  # of the engine; a task's overhead in a dask scheduler (guide, two workers on loopback)
ROWS = 20  # of a capture: a flat by itself gives 8, a chart some hundred

# %%
measured = json.loads((REPORTS / "scale.json").read_text())
faults = REPORTS / "faults.json"
survived = json.loads(faults.read_text()) if faults.is_file() else {"survived": {}, "failed": [], "rounds": 0, "files": 0}
per_file, megabytes = measured["measuring_ms_cpu_wall_per_file"], measured["capture_mb"]


def hours(seconds):
    return f"{seconds / 3600:.2g} h" if seconds >= 3600 else f"{seconds / 60:.2g} min"


def estimate(name, cpu_ms, capture_mb):
    """Wall time of a way to measure, and what bounds it."""
    cpu_s = CAPTURES * cpu_ms / 1e3 / (MACHINES * WORKERS)
    network_s = CAPTURES * capture_mb / (MACHINES * NETWORK_MB_S)
    scheduler_s = CAPTURES / TASK_FILES * TASK_MS / 1e3
    bound = max((cpu_s, "processors"), (network_s, "network"), (scheduler_s, "scheduler"))
    return {
        "name": name,
        "cpu_ms": f"{cpu_ms:.3g}",
        "cpu": hours(cpu_s),
        "network": hours(network_s),
        "scheduler": hours(scheduler_s),
        "whole": hours(bound[0]),
        "bound": bound[1],
    }


ways = [(kind, name, times[0]) for kind, own in per_file.items() for name, times in own.items()]
estimates = [estimate(f"{name}, {kind}", cpu_ms, megabytes[kind]) for kind, name, cpu_ms in ways]
archive = measured["archive_cpu"]
sizes = [
    ("store, all records", f"{measured['store_bytes_per_file'] * CAPTURES / 1e9:.2g} GB"),
    (f"archive, {ROWS} rows a capture", f"{archive['bytes_per_row'] * ROWS * CAPTURES / 1e9:.2g} GB"),
    ("adding all rows to the archive, one core", hours(archive["write_s"] / archive["rows"] * ROWS * CAPTURES)),
    ("trend of one metric over all captures, one core, if linear", hours(archive["trend_s"] / archive["rows"] * ROWS * CAPTURES)),
]

# %%
figure = Figure(figsize=(9, 3.4), layout="constrained")
left, right = figure.subplots(1, 2)
for axis, key, label in ((left, "files", "small files"), (right, "pixels", "pixels of one flat")):
    points = measured["growth_s_cpu"][key]
    axis.loglog(*zip(*points, strict=True), "o-")
    slope = measured["growth_s_cpu"][f"exponent_{key}"]
    axis.set(xlabel=label, ylabel="CPU, s", title="" if slope is None else f"exponent {slope:.2f}, first point left out")
    axis.grid(alpha=0.3)
picture = base64.b64encode(figure_bytes(figure, "svg")).decode("ascii")

# %%
PAGE = """<!doctype html><html lang="en"><head><meta charset="utf-8"><title>Scale</title><style>
body{font:15px/1.45 system-ui,sans-serif;max-width:62rem;
margin:2rem auto;padding:0 1rem;color:#222;background:#fff}
table{border-collapse:collapse;margin:.6rem 0 1.4rem}td,th{padding:.25rem .7rem;
border-bottom:1px solid #ddd;text-align:left}
td.n{text-align:right;font-variant-numeric:tabular-nums}.soft{color:#666}img{max-width:100%}
@media(prefers-color-scheme:dark){body{background:#181a1b;color:#ddd}td,th{border-color:#444}img{background:#fff}}
</style></head><body>
<h1>{{ captures }} captures on {{ machines }} machines</h1>
<p>{{ machines }} machines of {{ workers }} workers each, 12 MP captures of {{ mb }} MB
that every machine reads over a line of {{ line }}
MB/s (stated, not measured).
Rates are CPU times of this machine ({{ cores }} cores, load {{ load }}); what bounds the run is named.</p>
<table><tr><th>what is done with a capture</th>
<th>CPU a file, ms</th>
<th>processors</th>
<th>network</th>
<th>scheduler</th>
<th>whole run</th>
<th>bound by</th></tr>
{% for e in estimates %}<tr><td>{{ e.name }}</td>
<td class="n">{{ e.cpu_ms }}</td>
<td class="n">{{ e.cpu }}</td>
<td class="n">{{ e.network }}</td>
<td class="n">{{ e.scheduler }}</td>
<td class="n"><b>{{ e.whole }}</b></td>
<td>{{ e.bound }}</td></tr>
{% endfor %}</table>
<table>{% for name, value in sizes %}<tr><td>{{ name }}</td>
<td class="n">{{ value }}</td></tr>{% endfor %}</table>
<h2>Measured</h2><table><tr><th></th>
<th>measured</th>
<th>goal</th></tr>
{% for name, value, goal in table %}<tr><td>{{ name }}</td>
<td class="n">{{ "-" if value is none else "%.3g"|format(value) }}</td>
<td>{{ goal }}</td></tr>
{% endfor %}</table>
<p class="soft">Where others use the cores two workers take turns with one by the clock;
their CPU a file says what contention costs.</p>
<h2>Cost against size</h2><img alt="CPU against number of files and of pixels" src="data:image/svg+xml;base64,{{ picture }}">
<h2>Faults survived</h2>
<p>{{ survived.rounds }} rounds on {{ survived.files }} captures, each at a random moment; after every one the same command ended
with the same result to the last bit, without litter
and without orphans{{ "" if not survived.failed else ", except " ~ survived.failed|length }}.</p>
<table>{% for name, count in survived.survived.items() %}<tr><td>{{ name.replace("_", " ") }}</td>
<td class="n">{{ count }}</td></tr>{% endfor %}</table>
</body></html>
"""
page = Environment(autoescape=True).from_string(PAGE)
text = page.render(
    captures=f"{CAPTURES:,}",
    machines=MACHINES,
    workers=WORKERS,
    mb=", ".join(f"{mb:.1f} ({kind})" for kind, mb in megabytes.items()),
    line=NETWORK_MB_S,
    cores=measured["cores"],
    load=" to ".join(f"{v:.1f}" for v in measured["load_before_after"]),
    estimates=estimates,
    sizes=sizes,
    table=measured["table"],
    picture=picture,
    survived=survived,
)
(REPORTS / "scale.html").write_text(text, encoding="utf-8")
print("\n".join(f"{e['name']}: {e['whole']}, bound by {e['bound']}" for e in estimates))
