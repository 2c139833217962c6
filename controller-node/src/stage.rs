//! A new version of the cell, made ready beside the one that runs: read, compared, compiled, instantiated, on a thread that no
//! running MC has to wait for.

use crate::hosted;
use crate::real_time;
use crate::replica_thread::ReplicaJob;
use crate::run::NodeOptions;
use crossbeam_channel::Sender;
use fam_agents::node::NodeLocal;
use fam_engineering::BuiltCell;
use fam_engineering::changes::{self, Difference};
use fam_engineering::reload::{self, McChange};
use fam_node_core::plc::PlcRuntime;
use fam_node_core::{Carry, McSpec, StagedVersion};
use fam_proto::model::{McModel, state_room};
use fam_proto::{McId, Staged, StagedMc};
use fam_soft_plc::Engine;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};
use tokio::sync::mpsc::UnboundedSender;

/// What can be exchanged while the cell runs; everything else of an MC is the gateway's and the manager's business too.
const LIVE: [&str; 3] = ["logic", "state layout", "critical intervals"];

/// What a new version of the cell comes to on this controller.
struct Ready {
    models: Vec<Arc<McModel>>,
    versions: Vec<(usize, Box<StagedVersion<PlcRuntime>>)>,
    changes: String,
}

/// Makes new versions ready when the manager asks.
pub(crate) struct Stager {
    pub options: NodeOptions,
    pub engine: Engine,
    /// What the node hosts, by index.
    pub specs: Vec<Arc<McSpec>>,
    /// The cell with each MC in the version that runs.
    pub running: Arc<Mutex<BuiltCell>>,
    /// The cell that was read last.
    pub staged: Arc<Mutex<Option<BuiltCell>>>,
    pub jobs: Sender<ReplicaJob<PlcRuntime>>,
    pub news: UnboundedSender<NodeLocal>,
}

impl Stager {
    /// Begins; the answer comes as [`NodeLocal::Staged`].
    pub(crate) fn stage(&self, id: u64) {
        let (options, engine) = (self.options.clone(), self.engine.clone());
        let specs = self.specs.clone();
        let (running, staged) = (self.running.clone(), self.staged.clone());
        let (jobs, news) = (self.jobs.clone(), self.news.clone());
        let body = move || {
            real_time::normal_priority();
            let running = running.lock().unwrap_or_else(PoisonError::into_inner);
            let ready = read(&options, &engine, &specs, &running).map(|(ready, built)| {
                *staged.lock().unwrap_or_else(PoisonError::into_inner) = Some(built);
                ready
            });
            drop(running);
            let (models, answer) = tell(id, ready, &jobs);
            let _ = news.send(NodeLocal::Staged {
                models,
                staged: Box::new(answer),
            });
        };
        let begun = std::thread::Builder::new()
            .name("fam-stage".to_owned())
            .spawn(body);
        if let Err(error) = begun {
            let (models, answer) = tell(id, Err(format!("no thread: {error}")), &self.jobs);
            let _ = self.news.send(NodeLocal::Staged {
                models,
                staged: Box::new(answer),
            });
        }
    }

    /// The staged version of an MC is the one that runs now.
    pub(crate) fn renewed(&self, mc: &McId, version: u64) {
        tracing::info!(mc = %mc, "{mc} has version {version:016x} here now");
        let staged = self.staged.lock().unwrap_or_else(PoisonError::into_inner);
        let Some(new) = staged.as_ref() else { return };
        let mut running = self.running.lock().unwrap_or_else(PoisonError::into_inner);
        let place = |cell: &BuiltCell| cell.model.mcs.iter().position(|m| &m.mc == mc);
        if let (Some(from), Some(to)) = (place(new), place(&running))
            && new.model.mcs[from].hash == version
        {
            running.model.mcs[to] = new.model.mcs[from].clone();
            running.mcs[to] = new.mcs[from].clone();
        }
    }
}

/// Hands the new instances to the replica thread before anybody can be told of them.
fn tell(
    id: u64,
    ready: Result<Ready, String>,
    jobs: &Sender<ReplicaJob<PlcRuntime>>,
) -> (Vec<Arc<McModel>>, Staged) {
    let (ready, refused) = match ready {
        Ok(ready) => (Some(ready), None),
        Err(why) => (None, Some(why)),
    };
    let mut answer = Staged {
        id,
        mcs: Vec::new(),
        changes: String::new(),
        refused,
    };
    let Some(ready) = ready else {
        return (Vec::new(), answer);
    };
    for (mc, version) in ready.versions {
        let _ = jobs.send(ReplicaJob::Stage { mc, version });
    }
    answer.changes = ready.changes;
    answer.mcs = ready
        .models
        .iter()
        .map(|m| StagedMc {
            mc: m.mc.clone(),
            version: m.hash,
            layout: m.layout,
        })
        .collect();
    (ready.models, answer)
}

fn read(
    options: &NodeOptions,
    engine: &Engine,
    specs: &[Arc<McSpec>],
    running: &BuiltCell,
) -> Result<(Ready, BuiltCell), String> {
    let built = fam_engineering::build(&options.cell).map_err(|problems| problems.to_string())?;
    let change = reload::compare(running, &built);
    refuse_what_needs_a_restart(&change.cell, &change.mcs)?;
    let mut ready = Ready {
        models: Vec::new(),
        versions: Vec::new(),
        changes: change.to_string(),
    };
    for (index, spec) in specs.iter().enumerate() {
        if !matches!(change.mcs.get(&spec.mc), Some(McChange::Changed { .. })) {
            continue;
        }
        let model = built.model.mc(&spec.mc);
        let (Some(model), Some(old), Some(new)) = (model, running.mc(&spec.mc), built.mc(&spec.mc))
        else {
            continue;
        };
        // The node has known the MC from its start on, as the gateway has.
        let (grown, room) = (new.initial_checkpoint.len(), state_room(spec.initial.len()));
        if grown > room {
            return Err(format!(
                "the state of {} has grown to {grown} bytes, and the gateway's record has room for {room}; start the gateway with a new record file, from a stopped plant",
                spec.mc
            ));
        }
        let hosted = hosted::one(index, model, new, engine, options.cache.as_deref());
        let (new_spec, runtime) = hosted.map_err(|error| error.to_string())?;
        let kept = reload::kept_ranges(old, new);
        let carry = Carry {
            from: old_layout(running, &spec.mc).unwrap_or(spec.layout),
            from_len: old.initial_checkpoint.len(),
            copies: kept.copies,
            zeros: kept.zeros,
            bits: kept.bits,
        };
        ready.versions.push((
            index,
            Box::new(StagedVersion {
                version: model.hash,
                spec: new_spec,
                runtime,
                carry,
            }),
        ));
        ready.models.push(Arc::new(model.clone()));
    }
    Ok((ready, built))
}

fn old_layout(running: &BuiltCell, mc: &McId) -> Option<fam_proto::LayoutHash> {
    running.model.mc(mc).map(|m| m.layout)
}

/// Whatever changes beside the logic of MCs would have to change at the gateway and the manager at the same moment.
fn refuse_what_needs_a_restart(
    cell: &[String],
    mcs: &BTreeMap<McId, McChange>,
) -> Result<(), String> {
    let mut list: Vec<String> = cell.to_vec();
    for (mc, change) in mcs {
        match change {
            McChange::Same => {}
            McChange::Added => list.push(format!("{mc} is new")),
            McChange::Removed => list.push(format!("{mc} is gone")),
            McChange::Settings(what) => {
                list.push(format!("{mc} has another {}", changes::line(what)))
            }
            McChange::Changed { what, .. } => {
                let more: Vec<&Difference> =
                    what.iter().filter(|w| !LIVE.contains(&w.of)).collect();
                if !more.is_empty() {
                    list.push(format!("{mc} has other {}", changes::line(more)));
                }
            }
        }
    }
    if list.is_empty() {
        return Ok(());
    }
    Err(format!(
        "only logic, state and critical intervals of MCs can change while the cell runs; the rest needs its processes started again: {}",
        list.join("; ")
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_needs_a_restart_is_listed_whole() {
        let changed = |what: &[&'static str]| McChange::Changed {
            what: what.iter().map(|w| Difference::plain(w)).collect(),
            state: reload::StateChange::default(),
        };
        let mc = |name: &str| McId::new(name).unwrap();
        let fine = BTreeMap::from([
            (mc("A"), changed(&["logic", "state layout"])),
            (mc("B"), McChange::Same),
        ]);
        assert_eq!(refuse_what_needs_a_restart(&[], &fine), Ok(()));
        let mut more = fine;
        more.insert(mc("C"), changed(&["logic", "inputs", "cycle"]));
        more.insert(mc("D"), McChange::Added);
        let why = refuse_what_needs_a_restart(&["controller c9 is new".to_owned()], &more);
        let why = why.unwrap_err();
        for part in [
            "controller c9 is new",
            "C has other inputs; cycle",
            "D is new",
        ] {
            assert!(why.contains(part), "{why}");
        }
    }
}
