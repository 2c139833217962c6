//! Full disks: small file systems of our own, in a mount namespace of the test's thread.

use crate::cell::{C1, C2, Cell, GATEWAY, MANAGER};
use crate::journal::monotonic_us;
use fam_proto::{CommandKind, EventKind};
use std::ffi::CString;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Room for a repository and for the records, but for little more.
const DISK: &str = "size=6m";
/// More commands than any growth of the repository's file has room for.
const COMMANDS_MAX: u32 = 4_000;

/// Mounts a small file system that this thread and its children see alone; it ends with them.
fn small_disk(name: &str) -> PathBuf {
    let dir = tempfile::Builder::new()
        .prefix(name)
        .tempdir()
        .expect("a temporary folder")
        .keep();
    let c = |text: &str| CString::new(text).expect("no 0 in it");
    let path = c(&dir.display().to_string());
    // SAFETY: strings end with 0; the namespace is this thread's alone.
    unsafe {
        assert_eq!(libc::unshare(libc::CLONE_NEWNS), 0, "a mount namespace");
        let private = libc::MS_REC | libc::MS_PRIVATE;
        let none = std::ptr::null();
        assert_eq!(
            libc::mount(none, c("/").as_ptr(), none, private, none.cast()),
            0,
            "private mounts"
        );
        let tmpfs = c("tmpfs");
        let options = c(DISK);
        assert_eq!(
            libc::mount(
                tmpfs.as_ptr(),
                path.as_ptr(),
                tmpfs.as_ptr(),
                0,
                options.as_ptr().cast()
            ),
            0,
            "a small tmpfs"
        );
    }
    dir
}

/// Writes until there is no room.
fn fill(disk: &Path) -> PathBuf {
    let ballast = disk.join("ballast");
    let mut file = std::fs::File::create(&ballast).expect("a file");
    let piece = [0; 4_096];
    while file.write_all(&piece).is_ok() {}
    ballast
}

#[test]
fn a_full_disk_at_the_manager_is_an_alarm_and_the_plant_goes_on() {
    let Some(mut cell) = Cell::prepare(&[C1, C2]) else {
        return;
    };
    let disk = small_disk("fam-manager-disk");
    cell.folders.insert(MANAGER.to_owned(), disk.clone());
    cell.begin();
    let since_us = monotonic_us();
    let ballast = fill(&disk);
    // The file has room in itself: history is made until it has to grow.
    let mc = cell.mcs.first().expect("an MC").clone();
    let failed = (0..COMMANDS_MAX).find(|n| {
        cell.command(if n % 2 == 0 {
            CommandKind::Pin {
                mc: mc.clone(),
                to: None,
            }
        } else {
            CommandKind::Unpin(mc.clone())
        });
        let told = &["\"kind\":\"repository-failed\""];
        cell.log(MANAGER).wait(0, told, Duration::ZERO).is_some()
    });
    assert!(failed.is_some(), "no alarm\n{}", cell.report());
    cell.command(CommandKind::Unpin(mc));
    // A failover, and its way back: epochs of the reserved block serve.
    let (lost, _) = cell.busiest();
    cell.kill(&lost);
    cell.until_driven_without("a failover with a full disk", &[lost.as_str()]);
    cell.run(&lost);
    cell.rest("with a full disk");
    std::fs::remove_file(ballast).expect("the ballast goes");
    let (from, mcs) = cell.busiest();
    cell.move_along(&mcs[0], if from == C1 { C2 } else { C1 });
    cell.rest("after the disk had room again");
    assert!(
        cell.log(MANAGER)
            .wait(
                0,
                &["the repository is written again"],
                Duration::from_secs(10)
            )
            .is_some(),
        "it does not recover\n{}",
        cell.report()
    );
    // What was gathered meanwhile is there for the next life.
    cell.kill(MANAGER);
    cell.run(MANAGER);
    cell.rest("after the manager's restart");
    cell.judge("a full disk at the manager", since_us);
    cell.told("a full disk", 0, &[EventKind::RepositoryFailed]);
}

#[test]
fn a_full_disk_at_the_gateway_stops_nothing_that_runs_and_refuses_a_first_start() {
    let Some(mut cell) = Cell::prepare(&[C1, C2]) else {
        return;
    };
    let disk = small_disk("fam-gateway-disk");
    let records = disk.join("records.bin");
    // A first start without room says what is needed.
    let ballast = fill(&disk);
    cell.folders.insert(GATEWAY.to_owned(), disk.clone());
    cell.run(GATEWAY);
    let status = cell.ended(GATEWAY);
    assert!(!status.success());
    let said = cell
        .log(GATEWAY)
        .wait(0, &["the disk has no room"], Duration::from_secs(5));
    assert!(said.is_some(), "{}", cell.report());
    assert!(!records.exists(), "no half file is left");
    std::fs::remove_file(ballast).expect("the ballast goes");

    cell.begin();
    let since_us = monotonic_us();
    fill(&disk);
    let (lost, _) = cell.busiest();
    cell.kill(&lost);
    cell.until_driven_without("a failover with a full disk", &[lost.as_str()]);
    cell.run(&lost);
    cell.rest("with a full disk");
    // Its own restart needs no room either.
    cell.kill(GATEWAY);
    cell.run(GATEWAY);
    cell.rest("after the gateway's restart on a full disk");
    cell.judge("a full disk at the gateway", since_us);
}
