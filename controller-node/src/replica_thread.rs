//! The replica thread: frames of other nodes into the passive instances, instances to the scan thread and back.

use crate::cpu::{Bell, monotonic_ns};
use crate::shared::Shared;
use crate::trace::{Point, Trace};
use crossbeam_channel::{Receiver, Sender, select_biased};
use fam_agents::node::NodeLocal;
use fam_driver::{FrameBytes, Link};
use fam_node_core::replica::FrameRefusal;
use fam_node_core::{ActiveMc, McRuntime, Replica, ReplicaOutcome, ScanCommand, StagedVersion};
use fam_proto::access::{McAct, McNews};
use fam_proto::{McId, keys};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;
use tokio::sync::mpsc::UnboundedSender;

/// Frames that wait for the replica thread; further ones are dropped and counted.
pub(crate) const FRAMES_WAITING_MAX: usize = 256;
/// Acts and returned instances that wait.
pub(crate) const JOBS_WAITING_MAX: usize = 1_024;
/// How often the end of the process is looked for.
const LOOK: Duration = Duration::from_millis(50);

/// Work other than frames; done first.
pub(crate) enum ReplicaJob<R> {
    /// An MC Agent asks.
    Act { mc: usize, act: McAct },
    /// The scan thread gives an instance back.
    Returned(Box<ActiveMc<R>>),
    /// A new version is ready beside the one that runs.
    Stage {
        mc: usize,
        version: Box<StagedVersion<R>>,
    },
}

/// What the replica thread is given.
pub(crate) struct ReplicaThread<R> {
    pub replicas: Vec<Replica<R>>,
    pub jobs: Receiver<ReplicaJob<R>>,
    pub frames: Receiver<(McId, FrameBytes)>,
    pub commands: Sender<ScanCommand<R>>,
    pub bell: Arc<Bell>,
    pub news: UnboundedSender<NodeLocal>,
    pub shared: Arc<Shared>,
    pub link: Link,
    pub trace: Arc<Trace>,
}

impl<R: McRuntime> ReplicaThread<R> {
    /// The thread's body; ends when the process stops.
    pub(crate) fn run(mut self) {
        while !self.shared.stopped() {
            select_biased! {
                recv(self.jobs) -> job => match job {
                    Ok(job) => self.job(job),
                    Err(_) => return,
                },
                recv(self.frames) -> frame => if let Ok((mc, bytes)) = frame {
                    self.frame(&mc, &bytes);
                },
                default(LOOK) => {}
            }
        }
    }

    fn job(&mut self, job: ReplicaJob<R>) {
        match job {
            ReplicaJob::Act { mc, act } => {
                let outcome = self.replicas[mc].act(act);
                self.outcome(mc, outcome);
            }
            ReplicaJob::Stage { mc, version } => self.replicas[mc].stage(version),
            ReplicaJob::Returned(active) => {
                let mc = active.spec().index;
                let outcome = self.replicas[mc].returned(active);
                self.outcome(mc, outcome);
                if let Some(id) = self.replicas[mc].held() {
                    self.shared.hold(mc, id);
                }
            }
        }
    }

    fn outcome(&mut self, mc: usize, outcome: ReplicaOutcome<R>) {
        let command = match outcome {
            ReplicaOutcome::Nothing => return,
            ReplicaOutcome::News(news) => return self.tell(mc, news),
            ReplicaOutcome::Activate(active) => ScanCommand::Activate(active),
            ReplicaOutcome::PassOn(act) => ScanCommand::Act { mc, act },
        };
        // The scan thread empties the queue when it is rung for, and at each tick; this thread may wait for it.
        let _ = self.commands.send(command);
        self.bell.ring();
    }

    fn tell(&self, mc: usize, news: McNews) {
        let mc = self.shared.specs[mc].mc.clone();
        let _ = self.news.send(NodeLocal::Mc { mc, news });
    }

    fn frame(&mut self, mc: &McId, bytes: &FrameBytes) {
        let Some(index) = self.shared.specs.iter().position(|s| &s.mc == mc) else {
            return;
        };
        let Some(seen) = self.replicas[index].frame(&bytes.contiguous()) else {
            return;
        };
        match seen.held {
            Ok(id) => {
                self.shared.hold(index, id);
                self.trace.add(|| Point::held(mc, id, monotonic_ns()));
            }
            // A delta against a checkpoint that was missed is made good by the next full one.
            Err(FrameRefusal::Late | FrameRefusal::NoBase(_)) => {}
            // Another controller runs the new version already; the word to hold it is on its way.
            Err(FrameRefusal::Layout(layout)) if self.replicas[index].awaits(layout) => {}
            Err(refusal) => {
                let refused = &self.shared.counters.frames_refused;
                refused.fetch_add(1, Ordering::Relaxed);
                let key = keys::frame(self.link.cell(), mc);
                self.link.count_bad(&key, None, &refusal);
            }
        }
        if let Some(successor) = seen.released_to {
            self.tell(index, McNews::Handed(successor));
        }
    }
}
