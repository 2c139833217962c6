//! The QoS Monitors: one interface for every quality of service, and the set of them that a manager watches.
//!
//! A quality of service brings three things: a monitor (what it sees in the cell and when it raises an event), a bid criterion (what
//! Controller Agents add to their bids and what a bid has to offer) and an objective (what a placement costs). Availability, work
//! balance and cycle time are three of a kind; a fourth is one more implementation in the set.

mod availability;
mod balance;
mod cycle_time;

pub use availability::{Availability, IMAGE_STALE_US, RETRY_US};
pub use balance::WorkBalance;
pub use cycle_time::CycleTime;

use crate::cell_view::CellView;
use fam_proto::model::McModel;
use fam_proto::{Bid, ControllerId, Holding, Now, QosEvent};
use std::fmt;
use std::hash::{Hash, Hasher};

/// What happened that a monitor may want to know of.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub enum News {
    /// A controller registered, or is back.
    Joined(ControllerId),
    /// A plan was accepted and begins: what it answers.
    PlanBegan(QosEvent),
    /// All moves of a plan have ended, well or not.
    PlanEnded,
    /// Diagnosis & Decision found that nothing is to be gained by answering this event.
    Declined(QosEvent),
}

/// A placement that is being weighed.
#[derive(Debug, Clone, Copy)]
pub struct Placement<'a> {
    /// What is known of the cell.
    pub view: &'a CellView,
    /// The MC.
    pub mc: &'a McModel,
    /// Where it might go.
    pub controller: &'a ControllerId,
    /// That controller's bid, if it was asked and has answered.
    pub bid: Option<&'a Bid>,
    /// What the MC's agent there holds, if it has said so.
    pub holding: Option<&'a Holding>,
}

/// A quality of service.
pub trait QualityOfService: fmt::Debug + Send + Sync {
    /// Its name, as events carry it.
    fn name(&self) -> &str;

    /// Looks at the cell after every change and at its own deadlines; what it returns is to be answered.
    fn monitor(&mut self, view: &CellView, now: Now) -> Vec<QosEvent>;

    /// When it wants to look again, and why.
    fn deadline(&self) -> Option<(Now, &'static str)> {
        None
    }

    /// Takes note of news.
    fn told(&mut self, news: &News, view: &CellView, now: Now) {
        let _ = (news, view, now);
    }

    /// Whether an event of its name that a Controller Agent raised is to be answered now.
    fn admit(&mut self, event: &QosEvent, view: &CellView, now: Now) -> bool {
        let _ = (event, view, now);
        true
    }

    /// Names of the values that bids have to carry for it.
    fn criteria(&self) -> Vec<String> {
        Vec::new()
    }

    /// Its bid criterion.
    ///
    /// # Errors
    /// Why the placement does not come into question.
    fn weigh(&self, placement: &Placement<'_>) -> Result<(), String> {
        let _ = placement;
        Ok(())
    }

    /// Its objective: what the placement costs; 0 is best. Costs decide among plans whose highest workloads count as equal.
    fn cost(&self, placement: &Placement<'_>) -> u64 {
        let _ = placement;
        0
    }

    /// A copy.
    fn boxed(&self) -> Box<dyn QualityOfService>;

    /// Feeds all of its state, so that two that differ feed different bytes.
    fn digest(&self, hasher: &mut dyn Hasher);
}

/// The qualities of service that a manager looks after.
#[derive(Debug)]
pub struct Qualities(Vec<Box<dyn QualityOfService>>);

impl Qualities {
    /// Availability, work balance and cycle time.
    #[must_use]
    pub fn standard() -> Qualities {
        Qualities(vec![
            Box::new(Availability::default()),
            Box::new(WorkBalance::default()),
            Box::new(CycleTime::default()),
        ])
    }

    /// None.
    #[must_use]
    pub fn none() -> Qualities {
        Qualities(Vec::new())
    }

    /// One more.
    #[must_use]
    pub fn with(mut self, quality: Box<dyn QualityOfService>) -> Qualities {
        self.0.push(quality);
        self
    }

    /// Lets all monitors look.
    pub fn monitor(&mut self, view: &CellView, now: Now) -> Vec<QosEvent> {
        self.0
            .iter_mut()
            .flat_map(|q| q.monitor(view, now))
            .collect()
    }

    /// Whether an event that a Controller Agent raised is to be answered: its monitor says so; an event of no monitor is not.
    pub fn admit(&mut self, event: &QosEvent, view: &CellView, now: Now) -> bool {
        self.0
            .iter_mut()
            .find(|q| q.name() == event.qos)
            .is_some_and(|q| q.admit(event, view, now))
    }

    /// Tells all.
    pub fn told(&mut self, news: &News, view: &CellView, now: Now) {
        for quality in &mut self.0 {
            quality.told(news, view, now);
        }
    }

    /// The earliest deadline.
    #[must_use]
    pub fn deadline(&self) -> Option<(Now, &'static str)> {
        self.0.iter().filter_map(|q| q.deadline()).min()
    }

    /// All criteria that bids have to carry.
    #[must_use]
    pub fn criteria(&self) -> Vec<String> {
        let mut criteria: Vec<String> = self.0.iter().flat_map(|q| q.criteria()).collect();
        criteria.sort_unstable();
        criteria.dedup();
        criteria
    }

    /// The first objection to a placement.
    ///
    /// # Errors
    /// Why the placement does not come into question.
    pub fn weigh(&self, placement: &Placement<'_>) -> Result<(), String> {
        self.0.iter().try_for_each(|q| q.weigh(placement))
    }

    /// What a placement costs in all.
    #[must_use]
    pub fn cost(&self, placement: &Placement<'_>) -> u64 {
        self.0.iter().map(|q| q.cost(placement)).sum()
    }
}

/// Keeps every byte, so that comparing is exact.
struct Bytes(Vec<u8>);

impl Hasher for Bytes {
    fn write(&mut self, bytes: &[u8]) {
        self.0.extend_from_slice(bytes);
    }
    fn finish(&self) -> u64 {
        self.0.len() as u64
    }
}

impl Qualities {
    fn bytes(&self) -> Vec<u8> {
        let mut bytes = Bytes(Vec::new());
        for quality in &self.0 {
            quality.name().hash(&mut bytes);
            quality.digest(&mut bytes);
        }
        bytes.0
    }
}

impl Clone for Qualities {
    fn clone(&self) -> Qualities {
        Qualities(self.0.iter().map(|q| q.boxed()).collect())
    }
}

impl PartialEq for Qualities {
    fn eq(&self, other: &Qualities) -> bool {
        self.bytes() == other.bytes()
    }
}

impl Eq for Qualities {}

impl Hash for Qualities {
    fn hash<H: Hasher>(&self, state: &mut H) {
        // Fed directly: the marks of moments and numbers have to reach the hasher.
        for quality in &self.0 {
            quality.name().hash(state);
            quality.digest(state);
        }
    }
}
