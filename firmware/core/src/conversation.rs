//! Who may speak, and that every request is executed once.

use rigel_protocol::{Command, Reply, Request, SCHEMA, VERSION};

/// The conversation that the rig is in, if any.
pub(crate) struct Conversation {
    number: Option<u32>,
    /// The one before: a late repetition of its hello does not open it again.
    former: Option<u32>,
    latest: u16,
    /// What was replied to the latest request.
    reply: Option<Reply>,
    /// The request that the tracker's owner was given.
    with_tracker: u16,
}

/// What is to be done with a request.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Verdict {
    /// Execute it.
    New,
    /// It was executed: only answer again.
    Again(Option<Reply>),
    /// A later one was heard.
    Stale,
    /// Nobody has said a hello that fits.
    Unknown,
}

impl Conversation {
    pub const fn new() -> Self {
        Self { number: None, former: None, latest: 0, reply: None, with_tracker: 0 }
    }

    /// Hears a hello; whether it opens a new conversation.
    pub fn hello(&mut self, sequence: u16, version: u16, schema: u32, conversation: u32) -> bool {
        let fits = version == VERSION && schema == SCHEMA;
        if !fits || self.former == Some(conversation) {
            return false;
        }
        if self.number == Some(conversation) {
            if self.is_newer(sequence) {
                (self.latest, self.reply) = (sequence, None);
            }
            return false;
        }
        self.with_tracker = 0;
        self.former = self.number;
        self.number = Some(conversation);
        (self.latest, self.reply) = (sequence, None);
        true
    }

    /// Judges a request that is no hello; a new one becomes the latest.
    ///
    /// Questions change nothing and are answered anew when repeated, but not when a later request was heard: an answer
    /// out of order would tell an old story.
    pub fn judge(&mut self, request: &Request) -> Verdict {
        if self.number.is_none() {
            return Verdict::Unknown;
        }
        let question = matches!(request.command, Command::Ping | Command::Status | Command::Tracker);
        if request.sequence == self.latest {
            return if question { Verdict::New } else { Verdict::Again(self.reply.clone()) };
        }
        if !self.is_newer(request.sequence) {
            return Verdict::Stale;
        }
        (self.latest, self.reply) = (request.sequence, None);
        Verdict::New
    }

    /// Remembers what was replied to the latest request.
    pub fn remember(&mut self, reply: &Reply) {
        self.reply = Some(reply.clone());
    }

    /// The latest request goes to the tracker's owner, who may take his time to reply.
    pub fn pass_to_tracker(&mut self) {
        self.with_tracker = self.latest;
    }

    /// Remembers what the tracker's owner replied, if nothing was asked since; the sequence number of his request, 0
    /// when an earlier conversation made it.
    pub fn remember_tracker(&mut self, reply: &Reply) -> u16 {
        if self.with_tracker == self.latest {
            self.remember(reply);
        }
        self.with_tracker
    }

    fn is_newer(&self, sequence: u16) -> bool {
        sequence.wrapping_sub(self.latest).cast_signed() > 0
    }
}
