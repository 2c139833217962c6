//! Questions to the manager: the status of the cell and the event history.

use super::MiddlewareManager;
use fam_proto::{
    AgentId, CellStatus, ControllerStatus, Envelope, Epoch, GatewayStatus, McId, McStatus, Message,
    Now, Query, QueryReply, Scan,
};

/// Events in one answer at most.
const EVENTS_MAX: u32 = 1_000;

impl MiddlewareManager {
    pub(super) fn query(
        &mut self,
        envelope: &Envelope,
        query: &Query,
        negotiation: Option<String>,
        now: Now,
    ) -> bool {
        let AgentId::Client(_) = envelope.from else {
            return false;
        };
        let reply = match query {
            Query::Status => QueryReply::Status(self.status(negotiation, now)),
            Query::Events { after, limit } => {
                let limit = (*limit).min(EVENTS_MAX) as usize;
                let (events, more) = self.desk.events_after(*after, limit);
                QueryReply::Events { events, more }
            }
        };
        self.desk
            .send(envelope.from.clone(), Message::QueryReply(Box::new(reply)));
        true
    }

    /// The cell as the manager sees it.
    #[must_use]
    pub fn status(&self, negotiation: Option<String>, now: Now) -> CellStatus {
        let view = &self.view;
        let mut in_progress: Vec<String> = negotiation.into_iter().collect();
        in_progress.extend(self.jobs_in_words());
        if let Some(why) = &self.desk.repository_failed {
            in_progress.push(format!("the repository cannot be written: {why}"));
        }
        CellStatus {
            cell: view.model.cell.to_string(),
            manager_boot: self.desk.boot(),
            at_us: now.0,
            generation: view.generation,
            controllers: self.controllers(),
            mcs: view
                .mcs
                .keys()
                .filter_map(|mc| self.mc_status(mc))
                .collect(),
            gateways: view
                .gateways
                .iter()
                .map(|(name, g)| GatewayStatus {
                    gateway: name.clone(),
                    boot: g.boot,
                    up: g.is_up(),
                    image: g.image.0,
                    bad_messages: g.bad_messages,
                })
                .collect(),
            in_progress: (!in_progress.is_empty()).then(|| in_progress.join("; ")),
            alarms: u32::try_from(self.desk.alarms()).unwrap_or(u32::MAX),
            bad_messages: self.bad_messages + self.bad_messages_link,
        }
    }

    fn controllers(&self) -> Vec<ControllerStatus> {
        let view = &self.view;
        view.controllers
            .iter()
            .map(|(name, c)| {
                let known = c.registration.as_ref().or(c.remembered.as_ref());
                let declared = view.model.controller(name).map(|m| m.cpu_factor_permille);
                ControllerStatus {
                    controller: name.clone(),
                    boot: c.owner().map(|o| o.boot),
                    up: c.is_up(),
                    drained: c.is_emptied(),
                    cpu_factor_permille: known
                        .map(|r| r.cpu_factor_permille)
                        .or(declared)
                        .unwrap_or(0),
                    report: c.report.clone(),
                    active: view
                        .mcs
                        .keys()
                        .filter(|mc| view.driver(mc).is_some_and(|o| &o.controller == name))
                        .cloned()
                        .collect(),
                    ineligible: c
                        .ineligible
                        .iter()
                        .map(|(mc, why)| (mc.clone(), why.clone()))
                        .collect(),
                    real_time: known.map_or(Vec::new(), |r| r.real_time.clone()),
                }
            })
            .collect()
    }

    fn mc_status(&self, mc: &McId) -> Option<McStatus> {
        let (model, view) = self.view.mc(mc)?;
        let record = view.record.as_ref();
        Some(McStatus {
            mc: mc.clone(),
            owner: record.and_then(|r| r.owner.as_ref().map(|o| o.controller.clone())),
            epoch: record.map_or(Epoch(0), |r| r.epoch),
            scan: record.map_or(Scan(0), |r| r.scan()),
            record: record.map_or("unknown", |r| r.state.word()).to_owned(),
            phase: record.and_then(|r| r.phase),
            state: view.state,
            pinned: view.pinned.clone(),
            rejected: record.map_or(0, |r| r.rejected),
            criticality: model.criticality,
        })
    }
}
