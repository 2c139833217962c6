//! The plot of workloads over time with the events marked, after Fig. 3 of the FMS-200 work-balance case study.

use super::Report;
use anyhow::{Result, anyhow};
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

const COLOURS: [RGBColor; 6] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(230, 159, 0),
    RGBColor(86, 180, 233),
];
const INK: RGBColor = RGBColor(51, 56, 64);
const GRID: RGBColor = RGBColor(226, 230, 235);

/// Colour of the n-th controller, as `#rrggbb`.
pub fn colour_of(n: usize) -> String {
    let c = COLOURS[n % COLOURS.len()];
    format!("#{:02x}{:02x}{:02x}", c.0, c.1, c.2)
}

/// Draws the plot.
///
/// # Errors
/// If the drawing library fails.
pub fn workload_svg(report: &Report) -> Result<String> {
    let mut text = String::new();
    draw(report, &mut text).map_err(|e| anyhow!("the workload plot could not be drawn: {e}"))?;
    Ok(text)
}

fn draw(report: &Report, text: &mut String) -> Result<(), Box<dyn std::error::Error>> {
    let end_s = report.seconds.max(1.0);
    let top = report
        .samples
        .iter()
        .map(|s| s.workload_percent)
        .fold(110.0_f64, f64::max)
        * 1.05;
    let root = SVGBackend::with_string(text, (1080, 460)).into_drawing_area();
    root.fill(&WHITE)?;
    let (head, body) = root.split_vertically(44);
    let mut chart = ChartBuilder::on(&body)
        .margin_right(24)
        .margin_top(26)
        .x_label_area_size(44)
        .y_label_area_size(58)
        .build_cartesian_2d(0.0..end_s, 0.0..top)?;
    chart
        .configure_mesh()
        .disable_x_mesh()
        .bold_line_style(GRID)
        .light_line_style(TRANSPARENT)
        .axis_style(INK)
        .x_desc("time in s")
        .y_desc("workload in % of the controller's limit")
        .label_style(("sans-serif", 13).into_font().color(&INK))
        .draw()?;
    // The limit.
    chart.draw_series(DashedLineSeries::new(
        vec![(0.0, 100.0), (end_s, 100.0)],
        6,
        4,
        RGBColor(176, 32, 32).stroke_width(1),
    ))?;
    // What was done, numbered as in the table.
    for (n, step) in report.steps.iter().enumerate() {
        chart.draw_series(DashedLineSeries::new(
            vec![(step.at_s, 0.0), (step.at_s, top)],
            2,
            3,
            RGBColor(140, 146, 156).stroke_width(1),
        ))?;
        let at = chart.backend_coord(&(step.at_s, top));
        let shift = if n > 0 && step.at_s - report.steps[n - 1].at_s < end_s * 0.018 {
            14
        } else {
            0
        };
        root.draw(&Circle::new((at.0, at.1 - 12 - shift), 9, INK.filled()))?;
        root.draw(&Text::new(
            (n + 1).to_string(),
            (at.0, at.1 - 12 - shift),
            ("sans-serif", 12)
                .into_font()
                .color(&WHITE)
                .pos(Pos::new(HPos::Center, VPos::Center)),
        ))?;
    }
    let mut x = 64;
    for (n, controller) in report.controllers().iter().enumerate() {
        let colour = COLOURS[n % COLOURS.len()];
        for run in runs(report, controller) {
            chart.draw_series(std::iter::once(PathElement::new(
                run,
                colour.stroke_width(2),
            )))?;
        }
        head.draw(&Rectangle::new([(x, 17), (x + 22, 22)], colour.filled()))?;
        head.draw(&Text::new(
            controller.clone(),
            (x + 28, 20),
            ("sans-serif", 14)
                .into_font()
                .color(&INK)
                .pos(Pos::new(HPos::Left, VPos::Center)),
        ))?;
        x += 48 + 8 * i32::try_from(controller.len()).unwrap_or(10);
    }
    root.present()?;
    Ok(())
}

/// Stretches in which the controller was up, as steps.
fn runs(report: &Report, controller: &str) -> Vec<Vec<(f64, f64)>> {
    let mut runs = vec![Vec::new()];
    for s in report.samples.iter().filter(|s| s.controller == controller) {
        if !s.up {
            runs.push(Vec::new());
            continue;
        }
        if let Some(run) = runs.last_mut() {
            if let Some(&(_, before)) = run.last() {
                run.push((s.at_s, before));
            }
            run.push((s.at_s, s.workload_percent));
        }
    }
    runs.retain(|r| r.len() > 1);
    runs
}
