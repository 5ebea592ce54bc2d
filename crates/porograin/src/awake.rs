//! Threads that stay awake between the loops of a step.
//!
//! A step is a chain of short loops over all threads with work for one between them. Left to themselves the others fall asleep
//! whenever there is nothing to do, and to wake one takes as long as many a loop. Here they go on looking for work.

use rayon::Yield;
use std::hint::spin_loop;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering::Relaxed};
use std::time::{Duration, Instant};

/// Some thread pool of this process is kept awake.
static TAKEN: AtomicBool = AtomicBool::new(false);
/// Nothing done so many times in a row: other processes may need the processor.
const PATIENCE: usize = 1 << 10;
/// Pauses between two looks for work.
const PAUSES: usize = 16;
/// Threads that have not come by then are busy elsewhere.
const START: Duration = Duration::from_millis(100);

/// Runs something inside the thread pool and keeps all of its threads awake meanwhile. One at a time does so in a process: within
/// it, or beside it, this is no more than [`rayon::scope`]. No other work should be under way in that pool: it might have to
/// wait for the end of this.
pub fn awake<R: Send>(run: impl FnOnce() -> R + Send) -> R {
    let threads = rayon::current_num_threads();
    if threads == 1 || TAKEN.swap(true, Relaxed) {
        return rayon::scope(|_| run());
    }
    let (over, arrived) = (&AtomicBool::new(false), &AtomicUsize::new(0));
    rayon::scope(|scope| {
        // Whatever becomes of the run, the others must not wait for ever.
        let end = End(over);
        let own = rayon::current_thread_index();
        scope.spawn_broadcast(move |_, context| {
            // The thread of the run comes by when it waits for others.
            if Some(context.index()) != own {
                arrived.fetch_add(1, Relaxed);
                look_for_work(over);
            }
        });
        // A thread that came later, in the middle of other work, would leave that undone until the end.
        let start = Instant::now();
        while arrived.load(Relaxed) + 1 < threads && !over.load(Relaxed) {
            spin_loop();
            over.fetch_or(start.elapsed() > START, Relaxed);
        }
        let result = run();
        drop(end);
        result
    })
}

struct End<'a>(&'a AtomicBool);

impl Drop for End<'_> {
    fn drop(&mut self) {
        self.0.store(true, Relaxed);
        TAKEN.store(false, Relaxed);
    }
}

fn look_for_work(over: &AtomicBool) {
    let mut idle = 0;
    while !over.load(Relaxed) {
        if rayon::yield_now() == Some(Yield::Executed) {
            idle = 0;
            continue;
        }
        (0..PAUSES).for_each(|_| spin_loop());
        idle += 1;
        if idle > PATIENCE {
            std::thread::yield_now();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rayon::prelude::*;

    fn sums(count: usize) -> Vec<u64> {
        (0..count as u64).map(|k| (0..3000 + k).into_par_iter().sum()).collect()
    }

    #[test]
    fn work_gets_done_by_any_number_of_threads_inside_itself_and_after_a_panic() {
        let expected = sums(200);
        for threads in [1, 2, 5] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            for _ in 0..20 {
                assert_eq!(pool.install(|| awake(|| awake(|| sums(200)))), expected);
            }
            let broken = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
                pool.install(|| awake(|| (0..1000).into_par_iter().for_each(|k| assert!(k < 999))));
            }));
            assert!(broken.is_err());
        }
    }
}
