//! What every use of iceoryx2 shares: the service type, a run's configuration, service names, errors.

use std::fmt::{Debug, Display};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use iceoryx2::config::Config;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::port::{DegradationAction, SendError};
use iceoryx2::prelude::{
    FileName, IceoryxSend, SemanticString, ServiceName, ZeroCopySend, ipc_threadsafe,
};
use iceoryx2::service::port_factory::publish_subscribe::PortFactory;
use rustix::process::{Resource, getrlimit};

use crate::attach::{Attach, AttachError, MAX_ROOT_BYTES};
use crate::message::Role;

/// The iceoryx2 service type of every service.
pub(crate) type Ipc = ipc_threadsafe::Service;

/// Disconnected senders whose messages one receiver keeps, for each process of a generation. Every
/// receive call scans a slot for each, so a larger number makes receiving slower.
const EXPIRED_CONNECTIONS: usize = 4;

/// Why the bus cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum BusError {
    /// The run cannot be attached to.
    #[error(transparent)]
    Attach(#[from] AttachError),
    /// The path of the run's folder is too long for socket names.
    #[error(
        "the path of the run's folder {path} has {} bytes, but socket names leave room for {MAX_ROOT_BYTES}: \
         choose a shorter folder", path.len()
    )]
    PathTooLong {
        /// The folder.
        path: String,
    },
    /// The lock file of the run's folder cannot be locked.
    #[error("cannot join the run in {path}: {cause}")]
    Membership {
        /// The folder.
        path: String,
        /// The operating system's error.
        cause: std::io::Error,
    },
    /// Another living process has the role.
    #[error(
        "the run already has a {} process in this place, and there can be only one: end the other one, or start this one in \
         another run", role.word()
    )]
    Taken {
        /// The role.
        role: Role,
    },
    /// A node, service or port cannot be created or opened.
    #[error("{what}: {cause}")]
    Open {
        /// What was tried.
        what: String,
        /// iceoryx2's error.
        cause: String,
    },
    /// The role may not send or receive on the service.
    #[error("the {} process may not {verb} on {service}", role.word())]
    WrongRole {
        /// The service.
        service: &'static str,
        /// The process's role.
        role: Role,
        /// "send" or "receive".
        verb: &'static str,
    },
    /// A receiver's queue is full. Queues hold everything that the protocol can put into them, so either the
    /// receiver hangs or one of the two processes has a bug.
    #[error("{service}: the queue of a receiver is full; it hangs or breaks the protocol")]
    Full {
        /// The service.
        service: &'static str,
    },
    /// The message reached fewer receivers than take part in the run.
    #[error(
        "{service}: delivered to {found} of {expected} receivers; the others have ended or never connected"
    )]
    Deserted {
        /// The service.
        service: &'static str,
        /// Receivers that take part in the run.
        expected: usize,
        /// Receivers that got the message.
        found: usize,
    },
    /// Sending, receiving or waiting failed.
    #[error("{what}: {cause}")]
    Transport {
        /// What was tried.
        what: &'static str,
        /// iceoryx2's error.
        cause: String,
    },
}

impl BusError {
    pub(crate) fn open(what: impl Display, cause: impl Display) -> Self {
        let cause = with_full_file_table(&cause);
        let limit = getrlimit(Resource::Fsize).current;
        Self::Open { what: what.to_string(), cause: with_limit_of_sizes(cause, limit) }
    }

    pub(crate) fn transport(what: &'static str, cause: impl Display) -> Self {
        Self::Transport { what, cause: with_full_file_table(&cause) }
    }
}

/// Open files below the limit at which it is the likely cause of an error: iceoryx2 has closed some again.
const FILE_MARGIN: u64 = 16;

/// iceoryx2's error, which does not tell when this process may open no more files.
fn with_full_file_table(cause: &dyn Display) -> String {
    let Some(limit) = getrlimit(Resource::Nofile).current else { return cause.to_string() };
    // When this list cannot be opened, all are in use.
    let open = std::fs::read_dir("/proc/self/fd").map_or(limit, |files| files.count() as u64);
    if open + FILE_MARGIN < limit {
        return cause.to_string();
    }
    format!(
        "{cause}; this process has {open} of at most {limit} files open: raise the limit, for example `ulimit -n 4096`"
    )
}

/// iceoryx2's error, with the limit of the size of files in bytes, if there is one: shared memory consists of files, and the error
/// does not tell when one may not grow.
fn with_limit_of_sizes(cause: String, limit: Option<u64>) -> String {
    let Some(limit) = limit else { return cause };
    format!(
        "{cause}; a file of this process, also one in shared memory, may have at most {} KiB: if that is too little, raise the \
         limit, for example `ulimit -f unlimited`",
        limit >> 10
    )
}

/// Creates a receiver that fails where it cannot connect to a sender. Left to itself, iceoryx2 warns and does not try again,
/// and what that sender sends is lost in silence: the sender counts the receiver as reached.
///
/// # Errors
/// When it cannot be created, or cannot connect to a sender that is there.
pub(crate) fn receiver<P, H>(
    service: &PortFactory<Ipc, P, H>,
    what: &str,
) -> Result<Subscriber<Ipc, P, H>, BusError>
where
    P: IceoryxSend + Debug + ?Sized,
    H: ZeroCopySend + Debug,
{
    let has_failed = Arc::new(AtomicBool::new(false));
    let failed = has_failed.clone();
    let builder = service.subscriber_builder().set_degradation_handler(move |_, _| {
        failed.store(true, Ordering::Relaxed);
        DegradationAction::DegradeAndFail
    });
    let receiver = builder.create().map_err(|e| BusError::open(what, e))?;
    // Creating it warns only, whatever the handler says.
    if has_failed.load(Ordering::Relaxed) {
        return Err(BusError::open(what, "no connection to a sender"));
    }
    Ok(receiver)
}

/// The name of service `name` in the generation of `attach`.
pub(crate) fn service_name(attach: &Attach, name: &str) -> Result<ServiceName, BusError> {
    let full = format!("{}/{name}", attach.generation);
    ServiceName::new(&full).map_err(|e| BusError::open(format_args!("service name {full}"), e))
}

/// The iceoryx2 configuration of the run of `attach`. Nothing is read from files or the environment.
pub(crate) fn config(attach: &Attach) -> Result<Config, BusError> {
    let mut config = run_config(&attach.prefix, &attach.root)?;
    config.defaults.publish_subscribe.subscriber_expired_connection_buffer =
        EXPIRED_CONNECTIONS * attach.places(&Role::ALL);
    Ok(config)
}

/// A configuration that names a run: its prefix in shared memory and its folder.
pub(crate) fn run_config(prefix: &str, root: &Path) -> Result<Config, BusError> {
    let path = root.display().to_string();
    if path.len() > MAX_ROOT_BYTES {
        return Err(BusError::PathTooLong { path });
    }
    let mut config = Config::default();
    config.global.prefix = FileName::new(prefix.as_bytes())
        .map_err(|e| BusError::open(format_args!("prefix {prefix}"), e))?;
    let root = iceoryx2::prelude::Path::new(path.as_bytes())
        .map_err(|e| BusError::open(format_args!("folder {path}"), e))?;
    config.global.set_root_path(&root);
    Ok(config)
}

/// Checks that a message reached all `expected` receivers.
pub(crate) fn delivered(
    service: &'static str,
    expected: usize,
    outcome: Result<usize, SendError>,
) -> Result<(), BusError> {
    match outcome {
        Ok(found) if found < expected => Err(BusError::Deserted { service, expected, found }),
        Ok(_) => Ok(()),
        Err(SendError::UnableToDeliver) => Err(BusError::Full { service }),
        Err(e) => Err(BusError::transport(service, e)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_limit_of_file_sizes_is_named_where_there_is_one() {
        let cause = || "UnableToCreateDataSegment".to_owned();
        assert_eq!(with_limit_of_sizes(cause(), None), cause());
        let named = with_limit_of_sizes(cause(), Some(1 << 20));
        assert!(named.contains("at most 1024 KiB") && named.contains("`ulimit -f"), "{named}");
    }
}
