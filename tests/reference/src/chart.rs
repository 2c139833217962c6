//! Random sequential function charts against a direct reading of clause 6.7: evolution (6.7.4), priorities of divergences, and
//! the action control of 6.7.3 with its flip-flops and timers, kept for each association. Steps, their times, variables and
//! counters of actions are compared after every scan.

use fam_soft_plc::{Engine, Instance, Value};

use crate::compare::{self, ENTRY};
use crate::random::Random;
use crate::shrink::Piece;

const MS_NS: i64 = 1_000_000;
const INPUTS: usize = 4;

#[derive(Clone, Copy, Debug, PartialEq)]
enum Qualifier {
    N,
    R,
    S,
    L,
    D,
    P,
    P0,
    P1,
    SD,
    DS,
    SL,
}

const QUALIFIERS: [Qualifier; 11] = [
    Qualifier::N,
    Qualifier::R,
    Qualifier::S,
    Qualifier::L,
    Qualifier::D,
    Qualifier::P,
    Qualifier::P0,
    Qualifier::P1,
    Qualifier::SD,
    Qualifier::DS,
    Qualifier::SL,
];

#[derive(Clone, Debug)]
enum Condition {
    Input(usize, bool),
    /// The time of a step, in ms, has been reached.
    Time(usize, i64),
}

impl Condition {
    fn text(&self) -> String {
        match self {
            Condition::Input(x, true) => format!("x{x}"),
            Condition::Input(x, false) => format!("NOT x{x}"),
            Condition::Time(step, ms) => format!("S{step}.T >= T#{ms}ms"),
        }
    }
}

#[derive(Clone, Debug)]
struct Transition {
    from: Vec<usize>,
    to: Vec<usize>,
    condition: Condition,
    priority: Option<i64>,
}

#[derive(Clone, Debug)]
struct Association {
    step: usize,
    action: usize,
    qualifier: Qualifier,
    time_ms: i64,
}

#[derive(Clone, Debug)]
struct Chart {
    steps: usize,
    transitions: Vec<Transition>,
    associations: Vec<Association>,
    /// The first ones are BOOL variables, the others count how often they run.
    actions: usize,
    variables: usize,
}

fn some(random: &mut Random, below: usize, most: i64) -> Vec<usize> {
    let mut list: Vec<usize> = Vec::new();
    for _ in 0..random.within(1, most) {
        let one = random.below(below);
        if !list.contains(&one) {
            list.push(one);
        }
    }
    list
}

impl Chart {
    fn random(random: &mut Random) -> Chart {
        let steps = random.within(2, 7) as usize;
        let mut transitions = Vec::new();
        for step in 0..steps {
            for _ in 0..random.within(1, 2) {
                let wide = random.chance(20);
                let from = if wide {
                    some(random, steps, 3)
                } else {
                    vec![step]
                };
                let to = if random.chance(25) {
                    some(random, steps, 3)
                } else {
                    vec![if random.chance(60) {
                        (step + 1) % steps
                    } else {
                        random.below(steps)
                    }]
                };
                let condition = if random.chance(60) {
                    Condition::Input(random.below(INPUTS), random.chance(70))
                } else {
                    Condition::Time(from[0], 10 * random.within(0, 4))
                };
                let priority = random.chance(30).then(|| random.within(1, 3));
                transitions.push(Transition {
                    from,
                    to,
                    condition,
                    priority,
                });
            }
        }
        let (variables, actions) = (3, 5);
        let mut associations = Vec::new();
        for step in 0..steps {
            for _ in 0..random.within(0, 3) {
                associations.push(Association {
                    step,
                    action: random.below(actions),
                    qualifier: *random.one(&QUALIFIERS),
                    time_ms: 10 * random.within(0, 5),
                });
            }
        }
        Chart {
            steps,
            transitions,
            associations,
            actions,
            variables,
        }
    }

    fn action_name(&self, action: usize) -> String {
        if action < self.variables {
            format!("v{action}")
        } else {
            format!("act{action}")
        }
    }

    fn text(&self, name: &str) -> Piece {
        let mut inner = vec![
            Piece::line("VAR_INPUT x0, x1, x2, x3 : BOOL; END_VAR"),
            Piece::line("VAR v0, v1, v2 : BOOL; c3, c4 : DINT; END_VAR"),
        ];
        for step in 0..self.steps {
            let own = self.associations.iter().filter(|a| a.step == step);
            let lines = own
                .map(|a| {
                    let timed = matches!(
                        a.qualifier,
                        Qualifier::L | Qualifier::D | Qualifier::SD | Qualifier::DS | Qualifier::SL
                    );
                    let time = if timed {
                        format!(", T#{}ms", a.time_ms)
                    } else {
                        String::new()
                    };
                    Piece::line(format!(
                        "{}({:?}{time});",
                        self.action_name(a.action),
                        a.qualifier
                    ))
                })
                .collect();
            let word = if step == 0 { "INITIAL_STEP" } else { "STEP" };
            inner.push(Piece::block(format!("{word} S{step}:"), lines, "END_STEP"));
        }
        let names = |list: &[usize]| match list {
            [one] => format!("S{one}"),
            many => {
                let list: Vec<String> = many.iter().map(|s| format!("S{s}")).collect();
                format!("({})", list.join(", "))
            }
        };
        for t in &self.transitions {
            let priority = t
                .priority
                .map_or(String::new(), |p| format!(" (PRIORITY := {p})"));
            let condition = t.condition.text();
            inner.push(Piece::line(format!(
                "TRANSITION{priority} FROM {} TO {} := {condition}; END_TRANSITION",
                names(&t.from),
                names(&t.to)
            )));
        }
        for action in self.variables..self.actions {
            inner.push(Piece::line(format!(
                "ACTION act{action}: c{action} := c{action} + 1; END_ACTION"
            )));
        }
        Piece::block(format!("PROGRAM {name}"), inner, "END_PROGRAM")
    }
}

/// Random charts for tests of other readers and writers of charts.
pub struct Sample {
    pub name: String,
    /// A PROGRAM, with the inputs `x0` to `x3`.
    pub text: String,
    /// The same as a `<pou>` element of PLCopen XML.
    pub drawn: String,
}

/// So many charts from a seed; `C0`, `C1` and so on behind `prefix` are their names.
pub fn samples(seed: u64, count: usize, prefix: &str) -> Vec<Sample> {
    let mut random = Random::new(seed ^ 0x5a3b);
    let of = |number| {
        let chart = Chart::random(&mut random);
        let name = format!("{prefix}C{number}");
        Sample {
            text: chart.text(&name).render(),
            drawn: chart.drawn(&name),
            name,
        }
    };
    (0..count).map(of).collect()
}

/// `<connectionPointIn>` with a connection to each element.
fn connected(ids: impl Iterator<Item = usize>) -> String {
    let list: String = ids
        .map(|id| format!("<connection refLocalId=\"{id}\"/>"))
        .collect();
    format!("<connectionPointIn>{list}</connectionPointIn>")
}

impl Chart {
    fn drawn(&self, name: &str) -> String {
        let transition_id = |number: usize| 100 + number;
        let mut body = String::new();
        for step in 0..self.steps {
            let leading = self.transitions.iter().enumerate();
            let leading = leading.filter(|(_, t)| t.to.contains(&step));
            let leading = connected(leading.map(|(n, _)| transition_id(n)));
            let initial = step == 0;
            body += &format!(
                "<step localId=\"{step}\" name=\"S{step}\" initialStep=\"{initial}\">{leading}</step>\n"
            );
            let own: String = self
                .associations
                .iter()
                .filter(|a| a.step == step)
                .map(|a| {
                    format!(
                        "<action localId=\"0\" qualifier=\"{:?}\" duration=\"T#{}ms\"><reference name=\"{}\"/></action>",
                        a.qualifier,
                        a.time_ms,
                        self.action_name(a.action)
                    )
                })
                .collect();
            if !own.is_empty() {
                let id = 200 + step;
                let at = connected([step].into_iter());
                body += &format!("<actionBlock localId=\"{id}\">{at}{own}</actionBlock>\n");
            }
        }
        for (number, t) in self.transitions.iter().enumerate() {
            let condition = t.condition.text().replace('<', "&lt;").replace('>', "&gt;");
            let priority = t
                .priority
                .map_or(String::new(), |p| format!(" priority=\"{p}\""));
            let from = connected(t.from.iter().copied());
            body += &format!(
                "<transition localId=\"{}\"{priority}>{from}<condition><inline name=\"\"><ST><xhtml:p>{condition}</xhtml:p></ST></inline></condition></transition>\n",
                transition_id(number)
            );
        }
        let variables = |ty: &str, names: &[&str]| -> String {
            let of = |n: &&str| format!("<variable name=\"{n}\"><type><{ty}/></type></variable>");
            names.iter().map(of).collect()
        };
        let actions: String = (self.variables..self.actions)
            .map(|a| format!("<action name=\"act{a}\"><body><ST><xhtml:p>c{a} := c{a} + 1;</xhtml:p></ST></body></action>"))
            .collect();
        format!(
            "<pou name=\"{name}\" pouType=\"program\"><interface><inputVars>{}</inputVars><localVars>{}{}</localVars></interface><actions>{actions}</actions><body><SFC>\n{body}</SFC></body></pou>\n",
            variables("BOOL", &["x0", "x1", "x2", "x3"]),
            variables("BOOL", &["v0", "v1", "v2"]),
            variables("DINT", &["c3", "c4"]),
        )
    }
}

/// A timer on delay: since when its input is true.
#[derive(Clone, Copy, Debug, Default)]
struct Delay(Option<i64>);

impl Delay {
    fn passed(&mut self, input: bool, now_ns: i64, time_ms: i64) -> bool {
        if !input {
            self.0 = None;
            return false;
        }
        now_ns - *self.0.get_or_insert(now_ns) >= time_ms * MS_NS
    }
}

/// What the action control remembers of an association.
#[derive(Clone, Copy, Debug, Default)]
struct Control {
    stored: bool,
    timer: Delay,
}

struct Reading<'c> {
    chart: &'c Chart,
    active: Vec<bool>,
    active_before: Vec<bool>,
    since_ns: Vec<i64>,
    time_ns: Vec<i64>,
    controls: Vec<Control>,
    variables: Vec<bool>,
    counts: Vec<i64>,
}

impl<'c> Reading<'c> {
    fn new(chart: &'c Chart) -> Self {
        let mut active = vec![false; chart.steps];
        active[0] = true;
        Self {
            chart,
            active,
            active_before: vec![false; chart.steps],
            since_ns: vec![0; chart.steps],
            time_ns: vec![0; chart.steps],
            controls: vec![Control::default(); chart.associations.len()],
            variables: vec![false; chart.actions],
            counts: vec![0; chart.actions],
        }
    }

    fn scan(&mut self, inputs: &[bool], now_ns: i64) {
        for step in 0..self.chart.steps {
            if self.active[step] && self.active_before[step] {
                self.time_ns[step] = now_ns - self.since_ns[step];
            }
        }
        self.evolve(inputs, now_ns);
        for step in 0..self.chart.steps {
            // The initial step begins with the first scan.
            if self.active[step] && !self.active_before[step] {
                self.since_ns[step] = now_ns;
            }
        }
        self.act(now_ns);
        self.active_before.clone_from(&self.active);
    }

    /// All enabled transitions whose condition is true are cleared at once; of those that share a step only the first.
    fn evolve(&mut self, inputs: &[bool], now_ns: i64) {
        let mut order: Vec<usize> = (0..self.chart.transitions.len()).collect();
        order.sort_by_key(|t| self.chart.transitions[*t].priority.unwrap_or(i64::MAX));
        let mut cleared: Vec<&Transition> = Vec::new();
        for number in order {
            let t = &self.chart.transitions[number];
            // What the first scan enters is tested from the second one on.
            let enabled = t.from.iter().all(|s| self.active_before[*s]);
            let taken = cleared
                .iter()
                .any(|c| c.from.iter().any(|s| t.from.contains(s)));
            let holds = match t.condition {
                Condition::Input(x, wanted) => inputs[x] == wanted,
                Condition::Time(step, ms) => self.time_ns[step] >= ms * MS_NS,
            };
            if enabled && !taken && holds {
                cleared.push(t);
            }
        }
        for t in &cleared {
            t.from.iter().for_each(|s| self.active[*s] = false);
        }
        for t in &cleared {
            for step in &t.to {
                self.active[*step] = true;
                self.since_ns[*step] = now_ns;
                self.time_ns[*step] = 0;
            }
        }
    }

    fn act(&mut self, now_ns: i64) {
        for action in 0..self.chart.actions {
            let own = |a: &&(usize, &Association)| a.1.action == action;
            let list: Vec<(usize, &Association)> =
                self.chart.associations.iter().enumerate().collect();
            let list: Vec<&(usize, &Association)> = list.iter().filter(own).collect();
            let reset = list
                .iter()
                .any(|(_, a)| a.qualifier == Qualifier::R && self.active[a.step]);
            let mut runs = false;
            for (number, a) in &list {
                let x = self.active[a.step];
                let before = self.active_before[a.step];
                let reached = self.time_ns[a.step] >= a.time_ms * MS_NS;
                let control = &mut self.controls[*number];
                // A flip-flop whose reset rules.
                let mut store = |set: bool| {
                    control.stored = !reset && (set || control.stored);
                    control.stored
                };
                runs |= match a.qualifier {
                    Qualifier::N => x,
                    Qualifier::R => false,
                    Qualifier::S => store(x),
                    Qualifier::L => x && !reached,
                    Qualifier::D => x && reached,
                    Qualifier::P | Qualifier::P1 => x && !before,
                    Qualifier::P0 => !x && before,
                    Qualifier::DS => store(x && reached),
                    Qualifier::SD => {
                        let on = store(x);
                        control.timer.passed(on, now_ns, a.time_ms)
                    }
                    Qualifier::SL => {
                        let on = store(x);
                        let passed = control.timer.passed(on, now_ns, a.time_ms);
                        on && !passed
                    }
                };
            }
            runs &= !reset;
            if list.is_empty() {
                continue;
            }
            self.variables[action] = runs;
            self.counts[action] += i64::from(runs);
        }
    }
}

/// Compares `count` random charts over `scans` scans each; the error shows the chart that differs.
pub fn compare(engine: &Engine, seed: u64, count: usize, scans: usize) -> Result<u64, String> {
    let mut random = Random::new(seed ^ 0x5fc5);
    let charts: Vec<Chart> = (0..count).map(|_| Chart::random(&mut random)).collect();
    let mut inner: Vec<Piece> = Vec::new();
    let mut calls = Vec::new();
    for (number, chart) in charts.iter().enumerate() {
        inner.push(chart.text(&format!("P{number}")));
        calls.push(Piece::line(format!("{number}: P{number}();")));
    }
    let main = vec![
        Piece::line("VAR_INPUT which : INT; END_VAR"),
        Piece::block("CASE which OF", calls, "END_CASE;"),
    ];
    inner.push(Piece::block(
        format!("PROGRAM {ENTRY}"),
        main,
        "END_PROGRAM",
    ));
    let tree = Piece {
        inner,
        ..Piece::default()
    };
    let built = compare::build(engine, &tree.render()).map_err(|problems| {
        let shown: String = problems.iter().take(5).map(ToString::to_string).collect();
        format!("seed {seed}: {shown}")
    })?;
    let mut compared = 0;
    for (number, chart) in charts.iter().enumerate() {
        let mut instance = built.instance(engine);
        instance
            .write(&format!("{ENTRY}.which"), Value::Int(number as i64))
            .map_err(|e| e.to_string())?;
        let mut reading = Reading::new(chart);
        let name = format!("P{number}");
        let mut history = String::new();
        for scan in 0..scans {
            let inputs: Vec<bool> = (0..INPUTS).map(|_| random.chance(40)).collect();
            history.push_str(&format!("{inputs:?}\n"));
            let now_ns = scan as i64 * 10 * MS_NS;
            for (x, on) in inputs.iter().enumerate() {
                instance
                    .write(&format!("{name}.x{x}"), Value::Bool(*on))
                    .map_err(|e| e.to_string())?;
            }
            instance
                .scan(now_ns, 2)
                .map_err(|t| format!("seed {seed}, {name}: {t}"))?;
            reading.scan(&inputs, now_ns);
            if let Some(what) = difference(&instance, &name, &reading) {
                let text = chart.text(&name).render();
                return Err(format!(
                    "seed {seed}, {name}, scan {scan}: {what}\ninputs:\n{history}{text}"
                ));
            }
            compared += 1;
        }
    }
    Ok(compared)
}

fn difference(instance: &Instance, name: &str, reading: &Reading<'_>) -> Option<String> {
    let chart = reading.chart;
    let mut wanted: Vec<(String, Value)> = Vec::new();
    for step in 0..chart.steps {
        wanted.push((format!("S{step}.X"), Value::Bool(reading.active[step])));
        wanted.push((format!("S{step}.T"), Value::Time(reading.time_ns[step])));
    }
    for action in 0..chart.actions {
        wanted.push(if action < chart.variables {
            (format!("v{action}"), Value::Bool(reading.variables[action]))
        } else {
            (format!("c{action}"), Value::Int(reading.counts[action]))
        });
    }
    wanted.into_iter().find_map(|(path, told)| {
        let ran = instance.read(&format!("{name}.{path}"))?;
        (ran != told).then(|| format!("{path} is {ran} in the program and {told} by the reading"))
    })
}
