//! What is told until somebody has heard it.

use heapless::String;
use rigel_protocol::{Answer, Command, Reply, Request};

use crate::Handled;

/// A text that every hello is told, until the host goes on: what is said once may be lost on the way.
pub struct Notice(Option<String<60>>);

impl Notice {
    /// A notice of this text, if there is any.
    pub const fn new(text: Option<String<60>>) -> Self {
        Self(text)
    }

    /// What is to be said after this request, which was handled so.
    pub fn after(&mut self, request: &Request, handled: &Handled) -> Option<Answer> {
        if let Command::Hello { .. } = request.command {
            let text = self.0.clone()?;
            return Some(Answer { sequence: request.sequence, reply: Reply::Log { text } });
        }
        if !matches!(handled, Handled::Answer(Answer { reply: Reply::Refused(_), .. })) {
            self.0 = None;
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use rigel_protocol::{Fault, SCHEMA, VERSION};

    use super::*;

    #[test]
    fn it_is_told_at_every_hello_until_a_request_was_obeyed() {
        let hello = |conversation| Command::Hello { version: VERSION, schema: SCHEMA, conversation };
        let pong = Handled::Answer(Answer { sequence: 4, reply: Reply::Pong { at_us: 1 } });
        for obeyed in [pong.clone(), Handled::Tracker] {
            let mut notice = Notice::new(Some("it hung".try_into().unwrap()));
            let request = |sequence, command| Request { sequence, command };
            let told = |sequence| {
                let reply = Reply::Log { text: "it hung".try_into().unwrap() };
                Some(Answer { sequence, reply })
            };
            assert_eq!(notice.after(&request(1, hello(5)), &pong), told(1));
            assert_eq!(notice.after(&request(1, hello(5)), &pong), told(1), "the answer was lost");
            // A host of before the restart, who has not said hello.
            let refused = Handled::Answer(Answer { sequence: 9, reply: Reply::Refused(Fault::NoHello) });
            assert_eq!(notice.after(&request(9, Command::Ping), &refused), None);
            assert_eq!(notice.after(&request(2, hello(6)), &pong), told(2));
            assert_eq!(notice.after(&request(4, Command::Ping), &obeyed), None);
            assert_eq!(notice.after(&request(5, hello(7)), &pong), None, "it was heard");
        }
        assert_eq!(Notice::new(None).after(&Request { sequence: 1, command: hello(1) }, &pong), None);
    }
}
