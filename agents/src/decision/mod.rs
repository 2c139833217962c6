//! Diagnosis & Decision (D&D): turns an event into a plan, by a contract net.
//!
//! ```text
//!            event or wish                all asked have answered,
//!   idle ------------------> negotiating ------------------------> decided: Plan, or nothing to do
//!    ^     call for proposals     |          or the deadline             |
//!    |                            | a failure comes in: begun anew       | the MM has checked the plan
//!    +----------------------------+<-------------------------------------+ award to those who won and lost
//! ```
//!
//! One negotiation at a time; failures go before operators' wishes, those before work balance. What bids say is true now and
//! wins over the last report. Where the MCs go is the planner's matter, how they are brought back the MC Agents'.

mod problem;
mod words;

use crate::cell_view::CellView;
use crate::monitor::Qualities;
use crate::planner::Solution;
use fam_proto::mark::{Mark, hash_marked};
use fam_proto::{
    AgentId, Award, Bid, BootId, CallForProposals, Cause, ControllerId, Envelope, Holding, McId,
    Message, Move, MoveKind, Now, Owner, Plan, QosEvent,
};
use problem::Free;
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::hash::{Hash, Hasher};

/// After the last bid, what the MCAs hold is waited for this long at most, in microseconds.
pub const HOLDINGS_GRACE_US: u64 = 1_000;
/// Where everything runs, bids are waited for so many times longer: nobody is in need, a failure overtakes, and a wish is better
/// granted late than refused because a loaded controller was slow to answer.
const PATIENCE: u64 = 10;
/// Events that wait for their turn; further ones are dropped, for their monitors raise them again.
const WAITING_MAX: usize = 256;
/// Criteria in one bid, at most.
const CRITERIA_MAX: usize = 64;

/// What an operator, or a state that an operator has set, wants of the placement.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Wish {
    /// This MC on that controller.
    Move {
        /// The MC.
        mc: McId,
        /// The controller.
        to: ControllerId,
        /// Taken from a healthy owner at once, without a handover.
        force: bool,
    },
    /// Nothing on that controller.
    Empty(ControllerId),
}

/// What D&D wants done or told.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub enum Decided {
    /// A plan, to be checked and carried out.
    Plan(Plan),
    /// No plan, and why.
    Nothing {
        /// What was to be answered.
        event: QosEvent,
        /// Why there is nothing to do.
        why: String,
        /// MCs that need a controller and find none, with the reason; the flag says that nobody could even be asked.
        left_out: Vec<(McId, String)>,
        /// Nobody could be asked.
        nobody: bool,
    },
    /// To a CA.
    Send(Envelope),
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
enum Urgency {
    Failure,
    Wish,
    Balance,
}

#[derive(Debug, Clone, PartialEq, Eq, Hash)]
struct Task {
    urgency: Urgency,
    event: QosEvent,
    wish: Option<Wish>,
}

#[derive(Debug, Clone, PartialEq, Eq)]
struct Negotiation {
    id: u64,
    task: Task,
    mcs: Vec<McId>,
    asked: BTreeSet<Owner>,
    bids: BTreeMap<ControllerId, Bid>,
    holdings: BTreeMap<(ControllerId, McId), Holding>,
    deadline: Now,
    last_bid: Option<Now>,
}

// Its number stands in each bid that counts, and is hashed once.
impl Hash for Negotiation {
    fn hash<H: Hasher>(&self, state: &mut H) {
        hash_marked(Mark::Negotiation, self.id, state);
        (&self.task, &self.mcs, &self.asked).hash(state);
        for bid in self.bids.values() {
            (&bid.owner, &bid.offers, bid.workload_permille).hash(state);
            (bid.memory_free_kb, bid.image_age_us, &bid.criteria).hash(state);
        }
        for (key, holding) in &self.holdings {
            (key, &holding.owner, holding.held).hash(state);
        }
        (self.deadline, self.last_bid).hash(state);
    }
}

impl Negotiation {
    fn is_over(&self, now: Now) -> bool {
        if now >= self.deadline {
            return true;
        }
        let all_bid = self
            .asked
            .iter()
            .all(|o| self.bids.contains_key(&o.controller));
        if !all_bid {
            return false;
        }
        let all_told = self.bids.values().all(|bid| {
            bid.offers.iter().filter(|o| o.unable.is_none()).all(|o| {
                self.holdings
                    .contains_key(&(bid.owner.controller.clone(), o.mc.clone()))
            })
        });
        all_told
            || self
                .last_bid
                .is_none_or(|at| now >= at.plus_us(HOLDINGS_GRACE_US))
    }

    fn until(&self) -> Now {
        let all_bid = self
            .asked
            .iter()
            .all(|o| self.bids.contains_key(&o.controller));
        match self.last_bid {
            Some(at) if all_bid => self.deadline.min(at.plus_us(HOLDINGS_GRACE_US)),
            _ => self.deadline,
        }
    }
}

/// The agent.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Decision {
    boot: BootId,
    last_id: u64,
    waiting: VecDeque<Task>,
    current: Option<Negotiation>,
    /// Who took part in the negotiation that led to a plan, until that is checked.
    open_award: Option<(u64, BTreeSet<ControllerId>)>,
    out: VecDeque<Decided>,
}

impl Hash for Decision {
    fn hash<H: Hasher>(&self, state: &mut H) {
        hash_marked(Mark::Negotiation, self.last_id, state);
        (self.boot, &self.waiting, &self.current, &self.out).hash(state);
        self.open_award
            .as_ref()
            .map(|(_, bidders)| bidders)
            .hash(state);
    }
}

impl Decision {
    /// An idle one. Numbers of negotiations begin with the boot id, so that a late bid of another life fits none.
    #[must_use]
    pub fn new(boot: BootId) -> Decision {
        Decision {
            boot,
            last_id: boot.0,
            waiting: VecDeque::new(),
            current: None,
            open_award: None,
            out: VecDeque::new(),
        }
    }

    /// A monitor's event.
    pub fn event(&mut self, event: QosEvent) {
        let urgency = match event.cause {
            Cause::ControllerLost(_) | Cause::McSilent(_) | Cause::McUnowned(_) => Urgency::Failure,
            Cause::Operator => Urgency::Wish,
            Cause::Overload(_) | Cause::Imbalance(_) | Cause::Overrun(..) | Cause::Custom(_) => {
                Urgency::Balance
            }
        };
        self.queue(Task {
            urgency,
            event,
            wish: None,
        });
    }

    /// An operator's wish.
    pub fn wish(&mut self, wish: Wish, detail: String) {
        let event = QosEvent {
            qos: "operator".to_owned(),
            cause: Cause::Operator,
            detail,
        };
        self.queue(Task {
            urgency: Urgency::Wish,
            event,
            wish: Some(wish),
        });
    }

    /// A bid. Late ones, and those of a life that was not asked, count for nothing.
    pub fn bid(&mut self, bid: Bid, now: Now) {
        if let Some(current) = &mut self.current
            && current.id == bid.negotiation
            && current.asked.contains(&bid.owner)
            && bid.offers.len() <= current.mcs.len()
            && bid.criteria.len() <= CRITERIA_MAX
        {
            current.last_bid = Some(now);
            current.bids.insert(bid.owner.controller.clone(), bid);
        }
    }

    /// What an MCA holds.
    pub fn holding(&mut self, holding: Holding) {
        if let Some(current) = &mut self.current
            && current.id == holding.negotiation
            && current.asked.contains(&holding.owner)
            && current.mcs.contains(&holding.mc)
        {
            let key = (holding.owner.controller.clone(), holding.mc.clone());
            current.holdings.insert(key, holding);
        }
    }

    /// Goes on as far as possible with what is known now.
    pub fn consider(&mut self, view: &CellView, qualities: &Qualities, now: Now) {
        if let Some(current) = &mut self.current {
            // Who is lost meanwhile is not waited for.
            current.asked.retain(|o| view.life_is_up(o));
            let overtaken = current.task.urgency > Urgency::Failure
                && self.waiting.iter().any(|t| t.urgency == Urgency::Failure);
            if overtaken {
                // A wish gets its turn later; an imbalance is raised again if it lasts.
                if let Some(given_up) = self.current.take()
                    && given_up.task.urgency == Urgency::Wish
                {
                    self.waiting.push_back(given_up.task);
                }
            } else if current.is_over(now)
                && let Some(done) = self.current.take()
            {
                self.decide(&done, view, qualities, now);
            }
        }
        while self.current.is_none() {
            let Some(at) =
                (0..self.waiting.len()).min_by_key(|at| (self.waiting[*at].urgency, *at))
            else {
                return;
            };
            let Some(task) = self.waiting.remove(at) else {
                return;
            };
            self.begin(task, view, qualities, now);
        }
    }

    /// The next deadline, and why.
    #[must_use]
    pub fn deadline(&self) -> Option<(Now, &'static str)> {
        self.current.as_ref().map(|c| (c.until(), "bids"))
    }

    /// What comes of it, oldest first.
    pub fn poll(&mut self) -> Option<Decided> {
        self.out.pop_front()
    }

    /// What is going on, in words.
    #[must_use]
    pub fn in_progress(&self) -> Option<String> {
        self.current.as_ref().map(|c| {
            format!(
                "negotiation {}: {} ({} of {} bids)",
                c.id,
                c.task.event.detail,
                c.bids.len(),
                c.asked.len()
            )
        })
    }

    /// The Middleware Manager has taken the plan: those who bid hear what they won.
    pub fn accepted(&mut self, plan: &Plan) {
        if let Some((negotiation, bidders)) = self.open_award.take() {
            for controller in bidders {
                let mcs = plan
                    .moves
                    .iter()
                    .filter(|m| m.to == controller)
                    .map(|m| m.mc.clone())
                    .collect();
                let award = Message::Award(Award { negotiation, mcs });
                self.send(controller, award);
            }
        }
    }

    /// The Middleware Manager has refused the plan: nobody won.
    pub fn refused(&mut self) {
        if let Some((negotiation, bidders)) = self.open_award.take() {
            for controller in bidders {
                let mcs = Vec::new();
                self.send(controller, Message::Award(Award { negotiation, mcs }));
            }
        }
    }

    fn queue(&mut self, task: Task) {
        let known = self
            .waiting
            .iter()
            .chain(self.current.as_ref().map(|c| &c.task))
            .any(|t| t.wish == task.wish && t.event.cause == task.event.cause);
        // A second wish of the same kind has to be answered as well; an event that is being answered need not.
        if (!known || task.wish.is_some()) && self.waiting.len() < WAITING_MAX {
            self.waiting.push_back(task);
        }
    }

    fn begin(&mut self, mut task: Task, view: &CellView, qualities: &Qualities, now: Now) {
        let homeless = view.homeless(now);
        let mcs: Vec<McId> = match (&task.wish, task.urgency) {
            (Some(Wish::Move { mc, .. }), _) => vec![mc.clone()],
            (Some(Wish::Empty(controller)), _) => problem::on_controller(view, controller),
            (None, Urgency::Failure) => homeless.iter().map(|(mc, _)| mc.clone()).collect(),
            (None, _) => problem::movable(view),
        };
        if task.urgency == Urgency::Failure {
            // One plan for all that is down: the events of the others are answered with it.
            let others: Vec<String> = self
                .waiting
                .iter()
                .filter(|t| t.urgency == Urgency::Failure)
                .map(|t| t.event.detail.clone())
                .collect();
            self.waiting.retain(|t| t.urgency != Urgency::Failure);
            for detail in others {
                task.event.detail.push_str("; ");
                task.event.detail.push_str(&detail);
            }
        }
        if mcs.is_empty() {
            if task.wish.is_some() {
                let (event, why) = (task.event, "there is nothing to be moved".to_owned());
                self.nothing(event, why, Vec::new(), false);
            }
            return;
        }
        let asked: BTreeSet<Owner> = view
            .controllers
            .iter()
            .filter(|(c, _)| match &task.wish {
                Some(Wish::Move { to, .. }) => *c == to,
                _ => true,
            })
            .filter(|(c, _)| mcs.iter().any(|mc| view.may_take(c, mc, now).is_ok()))
            .filter_map(|(_, there)| there.owner().cloned())
            .collect();
        self.last_id += 1;
        let within_us = match task.urgency {
            Urgency::Failure => view.model.settings.bids_us,
            Urgency::Wish | Urgency::Balance => PATIENCE * view.model.settings.bids_us,
        };
        let negotiation = Negotiation {
            id: self.last_id,
            task,
            mcs,
            asked,
            bids: BTreeMap::new(),
            holdings: BTreeMap::new(),
            deadline: now.plus_us(within_us),
            last_bid: None,
        };
        if negotiation.asked.is_empty() {
            self.decide(&negotiation, view, qualities, now);
            return;
        }
        for owner in &negotiation.asked {
            let call = CallForProposals {
                negotiation: negotiation.id,
                mcs: negotiation.mcs.clone(),
                criteria: qualities.criteria(),
                within_us,
            };
            let to = owner.controller.clone();
            self.send(to, Message::CallForProposals(call));
        }
        self.current = Some(negotiation);
    }

    fn decide(
        &mut self,
        negotiation: &Negotiation,
        view: &CellView,
        qualities: &Qualities,
        now: Now,
    ) {
        let mcs: BTreeSet<McId> = negotiation
            .mcs
            .iter()
            .filter(|mc| view.mcs.get(mc).is_some_and(|m| m.under_way.is_none()))
            .cloned()
            .collect();
        let input = problem::Asked {
            view,
            qualities,
            bids: &negotiation.bids,
            holdings: &negotiation.holdings,
            now,
            target: match &negotiation.task.wish {
                Some(Wish::Move { mc, to, .. }) => Some((mc, to)),
                _ => None,
            },
        };
        self.open_award = Some((negotiation.id, negotiation.bids.keys().cloned().collect()));
        let task = &negotiation.task;
        let balance = task.urgency == Urgency::Balance;
        let mut built = problem::build(&input, &mcs, Free::Called);
        let mut solution = crate::planner::plan(&built.problem);
        if !balance && input.target.is_none() && !solution.left_out.is_empty() {
            // What runs makes room if that helps; for an operator's wish nothing is stopped.
            let wider = problem::build(&input, &mcs, Free::All);
            let other = crate::planner::plan(&wider.problem);
            let (narrow, wide) = (
                built.names(&solution.left_out),
                wider.names(&other.left_out),
            );
            if wide != narrow && (task.wish.is_none() || wide.is_subset(&narrow)) {
                (built, solution) = (wider, other);
            }
        }
        let force = matches!(task.wish, Some(Wish::Move { force: true, .. }));
        let moves = moves(&built, &solution, view, force);
        let why = words::why(&task.event, &input, &built, &solution, &moves);
        let left_out = if balance {
            Vec::new()
        } else {
            built.left_out(&solution)
        };
        let evicts = left_out.iter().any(|(mc, _)| !mcs.contains(mc));
        let gains = !balance || built.is_gain(&solution, view, &task.event.cause);
        let nobody = negotiation.asked.is_empty();
        if !gains || (moves.is_empty() && !evicts) {
            self.refused();
            self.nothing(task.event.clone(), why, left_out, nobody);
            return;
        }
        self.out.push_back(Decided::Plan(Plan {
            id: view.generation.next(),
            parent: view.generation,
            event: task.event.clone(),
            moves,
            left_out,
            why,
            peak_permille: (
                permille(built.problem.peak_ppm(&built.stay())),
                permille(solution.peak_ppm),
            ),
        }));
    }

    fn nothing(
        &mut self,
        event: QosEvent,
        why: String,
        left_out: Vec<(McId, String)>,
        nobody: bool,
    ) {
        self.out.push_back(Decided::Nothing {
            event,
            why,
            left_out,
            nobody,
        });
    }

    fn send(&mut self, to: ControllerId, body: Message) {
        self.out.push_back(Decided::Send(Envelope {
            from: AgentId::Decision,
            boot: self.boot,
            to: AgentId::Controller(to),
            body,
        }));
    }
}

/// Moves of a solution, most critical MC first. What would go where a running MC has to be stopped first waits for the next plan.
fn moves(built: &problem::Built, solution: &Solution, view: &CellView, force: bool) -> Vec<Move> {
    let crowded: BTreeSet<u32> = solution
        .left_out
        .iter()
        .filter_map(|m| built.problem.mcs[*m].current)
        .collect();
    let mut moves: Vec<(u32, Move)> = Vec::new();
    for (m, place) in solution.assignment.iter().enumerate() {
        let (mc, demand) = (&built.mcs[m], &built.problem.mcs[m]);
        let Some(place) = place else { continue };
        if demand.fixed || demand.current == Some(*place) || crowded.contains(place) {
            continue;
        }
        let running = view.runs_on(mc).cloned();
        moves.push((
            demand.criticality,
            Move {
                mc: mc.clone(),
                kind: if running.is_some() && !force {
                    MoveKind::Handover
                } else {
                    MoveKind::Activate
                },
                from: running.or_else(|| view.driver(mc).map(|o| o.controller.clone())),
                to: built.controllers[*place as usize].clone(),
            },
        ));
    }
    moves.sort_by(|a, b| b.0.cmp(&a.0).then_with(|| a.1.mc.cmp(&b.1.mc)));
    moves.into_iter().map(|(_, m)| m).collect()
}

fn permille(ppm: u64) -> u32 {
    u32::try_from(ppm / 1_000).unwrap_or(u32::MAX)
}
