//! Memory that was used once is kept by the program.
//!
//! The pores of a million grains take gigabytes, made anew with every mesh. The allocator of glibc hands every array above 32 MB back to the
//! system as soon as it is freed, and the system clears each page again when the next array wants it: up to a fifth of the time of a
//! permeability (`benches/NOTES.md`).

/// Freed memory stays with the program, for all of its threads. To be called while there is but one thread.
#[cfg(all(target_os = "linux", target_env = "gnu"))]
pub fn keep() {
    // SAFETY: `mallopt` only sets parameters of the allocator; nobody else is allocating yet.
    unsafe {
        // Arrays above this size would be handed back; this is the largest that can be said.
        libc::mallopt(libc::M_MMAP_THRESHOLD, libc::c_int::MAX);
        libc::mallopt(libc::M_TRIM_THRESHOLD, libc::c_int::MAX);
        // Further arenas, those of the other threads, cannot hold large arrays.
        libc::mallopt(libc::M_ARENA_MAX, 1);
    }
}

/// Other allocators have rules of their own.
#[cfg(not(all(target_os = "linux", target_env = "gnu")))]
pub fn keep() {}
