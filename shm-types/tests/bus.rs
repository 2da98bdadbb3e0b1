//! Messages, bells and frames between nodes of one run.

mod common;

use std::time::Duration;

use bytemuck::Zeroable;
use common::{Run, bus, run};
use shm_types::message::{Role, StepCommand};

fn command(lane: u32) -> StepCommand {
    StepCommand { lane, ..Zeroable::zeroed() }
}

#[test]
fn a_message_reaches_its_receiver_and_rings() {
    let Run { attach, .. } = &run();
    let (orchestrator, sim) = (bus(attach, Role::Orchestrator), bus(attach, Role::Sim));
    let commands = sim.receiver::<StepCommand>().unwrap();
    let sender = orchestrator.sender::<StepCommand>().unwrap();
    let bell = orchestrator.bell(Role::Sim).unwrap();
    for lane in 0..16 {
        sender.send(&command(lane)).unwrap();
    }
    bell.ring().unwrap();
    assert!(sim.doorbell().wait(Duration::from_secs(60)).unwrap());
    let lanes: Vec<u32> = commands.drain().unwrap().iter().map(|c| c.lane).collect();
    assert_eq!(lanes, Vec::from_iter(0..16));
    assert_eq!(commands.next().unwrap(), None);
    while sim.doorbell().wait(Duration::ZERO).unwrap() {}
}
