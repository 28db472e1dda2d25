//! What people should know although the work goes on: a cable that was out, a rig that has restarted.

use std::collections::VecDeque;
use std::sync::{Mutex, PoisonError};

/// Kept for whoever asks later; whoever listens hears all of them.
const MOST_KEPT: usize = 1000;

type Listener = Box<dyn Fn(&str) + Send + Sync>;

/// Sentences, told at once to whoever listens and kept until they are taken.
#[derive(Default)]
pub(super) struct Notices {
    inner: Mutex<Inner>,
}

#[derive(Default)]
struct Inner {
    listener: Option<Listener>,
    kept: VecDeque<String>,
}

impl Notices {
    /// From now on; what was told before is told first.
    pub fn listen(&self, listener: Listener) {
        let mut inner = self.inner.lock().unwrap_or_else(PoisonError::into_inner);
        inner.kept.iter().for_each(|text| listener(text));
        inner.listener = Some(listener);
    }

    pub fn tell(&self, text: impl Into<String>) {
        let text = text.into();
        let mut inner = self.inner.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(listener) = &inner.listener {
            listener(&text);
        }
        if inner.kept.len() == MOST_KEPT {
            inner.kept.pop_front();
        }
        inner.kept.push_back(text);
    }

    /// What was told since the last time.
    pub fn take(&self) -> Vec<String> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner).kept.drain(..).collect()
    }
}
