//! The page: self-contained, opens offline.

use super::svg::colour_of;
use super::{Report, Step};

const STYLE: &str = "
:root{--ink:#1f2430;--soft:#5c6470;--line:#dfe3e8;--back:#fff;--tint:#f5f7f9;--good:#1b7f4b;--bad:#b02020}
*{box-sizing:border-box}
body{font:15px/1.5 system-ui,-apple-system,'Segoe UI',sans-serif;color:var(--ink);background:var(--tint);margin:0}
main{max-width:1120px;margin:0 auto;padding:28px 20px 60px}
h1{font-size:26px;margin:0 0 4px}h2{font-size:18px;margin:36px 0 10px}
p.sub{color:var(--soft);margin:0 0 20px}
.verdict{display:inline-block;padding:3px 12px;border-radius:4px;color:#fff;font-weight:600}
.verdict.good,.verdict.bad{color:#fff}.verdict.good{background:var(--good)}.verdict.bad{background:var(--bad)}
.figures{display:grid;grid-template-columns:repeat(auto-fit,minmax(150px,1fr));gap:12px;margin:20px 0}
.figure{background:var(--back);border:1px solid var(--line);border-radius:6px;padding:12px 14px}
.figure b{display:block;font-size:24px;font-variant-numeric:tabular-nums}
.figure span{color:var(--soft);font-size:13px}
.panel{background:var(--back);border:1px solid var(--line);border-radius:6px;padding:10px;overflow-x:auto}
.panel svg{display:block;width:100%;height:auto;min-width:700px}
table{border-collapse:collapse;width:100%;font-variant-numeric:tabular-nums}
th,td{text-align:left;padding:6px 10px;border-bottom:1px solid var(--line);vertical-align:top}
th{font-size:12px;color:var(--soft);font-weight:600}
td.n,th.n{text-align:right;white-space:nowrap}
td.s{white-space:nowrap;font-size:13px}
.dot{display:inline-block;width:10px;height:10px;border-radius:5px;margin-right:5px}
.good{color:var(--good)}.bad{color:var(--bad);font-weight:600}
tr.alarm td{color:var(--bad)}tr.warning td:first-child{border-left:3px solid #d98e00}
details summary{cursor:pointer;color:var(--soft)}
";

pub fn page(r: &Report, plot: &str) -> String {
    let (word, class) = if r.passed {
        ("All checks held", "good")
    } else {
        ("Some checks failed", "bad")
    };
    let controllers = r.controllers();
    let figures: String = [
        (r.totals.products, "products finished"),
        (r.totals.incidents, "incidents at the plant"),
        (
            r.totals.parts_lost + r.totals.parts_damaged,
            "parts lost or damaged",
        ),
        (r.totals.double_driven_scans, "double-driven scans"),
        (r.totals.frames_rejected, "frames rejected by the fence"),
        (r.totals.frames_applied, "frames applied"),
    ]
    .iter()
    .map(|(n, what)| format!("<div class=figure><b>{n}</b><span>{what}</span></div>"))
    .collect();
    let steps: String = r
        .steps
        .iter()
        .enumerate()
        .map(|(n, s)| step_row(n + 1, s, &controllers))
        .collect();
    let checks: String = r
        .checks
        .iter()
        .map(|c| {
            let (class, word) = if c.held {
                ("good", "held")
            } else {
                ("bad", "FAILED")
            };
            format!(
                "<tr><td class={class}>{word}</td><td>{}</td><td>{}</td></tr>",
                escape(&c.name),
                escape(&c.seen)
            )
        })
        .collect();
    let events: String = r
        .events
        .iter()
        .map(|e| {
            format!(
                "<tr class={}><td class=n>{:.3}</td><td class=s>{}</td><td class=s>{}</td><td class=s>{}</td><td>{}</td></tr>",
                e.severity,
                e.at_s,
                escape(&e.kind),
                escape(e.mc.as_deref().unwrap_or("")),
                escape(e.controller.as_deref().unwrap_or("")),
                escape(&e.text)
            )
        })
        .collect();
    format!(
        "<!doctype html><html lang=en><head><meta charset=utf-8><meta name=viewport content='width=device-width'>\
<title>FAM: {cell}</title><style>{STYLE}</style></head><body><main>\
<h1>Flexible assembly cell {cell}</h1>\
<p class=sub>{started}, {seconds:.1} s, plant seed {seed}, fam {version}</p>\
<span class='verdict {class}'>{word}</span>\
<div class=figures>{figures}</div>\
<h2>Workload of each controller</h2><div class=panel>{plot}</div>\
<h2>What was done, and what came of it</h2><div class=panel><table><thead><tr><th>#</th><th class=n>s</th><th>step</th>\
<th>workload before, %</th><th>after, %</th><th class=n>longest gap, ms</th><th class=n>missed scans</th><th class=n>rejected</th><th class=n>products</th></tr></thead>\
<tbody>{steps}</tbody></table></div>\
<h2>Checks</h2><div class=panel><table><tbody>{checks}</tbody></table></div>\
<h2>Event history</h2><div class=panel><details><summary>{count} events</summary><table><thead><tr><th class=n>s</th><th>kind</th><th>MC</th><th>controller</th><th>text</th></tr></thead>\
<tbody>{events}</tbody></table></details></div>\
</main></body></html>\n",
        cell = escape(&r.cell),
        started = escape(&r.started),
        seconds = r.seconds,
        seed = r.seed,
        version = escape(&r.version),
        count = r.events.len(),
    )
}

fn step_row(n: usize, s: &Step, controllers: &[String]) -> String {
    let loads = |loads: &[(String, f64)]| -> String {
        loads
            .iter()
            .map(|(c, percent)| {
                let colour = colour_of(controllers.iter().position(|x| x == c).unwrap_or(0));
                format!(
                    "<span class=dot style='background:{colour}'></span>{} {percent:.0}<br>",
                    escape(c)
                )
            })
            .collect()
    };
    format!(
        "<tr><td>{n}</td><td class=n>{:.1}</td><td><b>{}</b><br>{}</td><td class=s>{}</td><td class=s>{}</td><td class=n>{}</td><td class=n>{}</td><td class=n>{}</td><td class=n>{}</td></tr>",
        s.at_s,
        escape(&s.name),
        escape(&s.text),
        loads(&s.before),
        loads(&s.after),
        s.gap_ms.map_or(String::new(), |ms| format!("{ms:.1}")),
        s.missed_scans,
        s.rejected,
        s.products
    )
}

fn escape(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
        .replace('\'', "&#39;")
        .replace('"', "&quot;")
}
