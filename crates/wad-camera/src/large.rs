//! Buffers of a megabyte and more, on pages of two megabytes where the system has them: finding a small
//! page for every row costs a few per cent of a frame.

use std::alloc::{Layout, alloc, dealloc, handle_alloc_error};
use std::ops::{Deref, DerefMut};
use std::ptr::NonNull;

/// Size of a large page, and from which size on a buffer is worth one (bytes).
const PAGE: usize = 2 << 20;
const WORTH: usize = 1 << 20;

/// A buffer of numbers that is allocated again when its size changes.
pub struct Large<T: Copy> {
    start: NonNull<T>,
    len: usize,
    /// Of the allocation; None where there is none.
    layout: Option<Layout>,
}

impl<T: Copy> Default for Large<T> {
    fn default() -> Self {
        Self { start: NonNull::dangling(), len: 0, layout: None }
    }
}

impl<T: Copy> Large<T> {
    /// `len` times `value`.
    pub fn new(len: usize, value: T) -> Self {
        let bytes = len * size_of::<T>();
        if bytes == 0 {
            return Self { len, ..Self::default() };
        }
        let large = bytes >= WORTH;
        let (size, align) =
            if large { (bytes.next_multiple_of(PAGE), PAGE) } else { (bytes, align_of::<T>()) };
        let layout = Layout::from_size_align(size, align).unwrap_or(Layout::new::<T>());
        assert!(layout.size() >= bytes, "{bytes} bytes cannot be addressed");
        // SAFETY: the layout's size is not 0.
        let Some(start) = NonNull::new(unsafe { alloc(layout) }) else { handle_alloc_error(layout) };
        #[cfg(target_os = "linux")]
        if large {
            // SAFETY: the range is the allocation's own; it is advice only, and nothing is written yet.
            unsafe { libc::madvise(start.as_ptr().cast(), size, libc::MADV_HUGEPAGE) };
        }
        let start = start.cast::<T>();
        for i in 0..len {
            // SAFETY: within the allocation, which is aligned for T.
            unsafe { start.add(i).write(value) };
        }
        Self { start, len, layout: Some(layout) }
    }

    /// Makes it `len` times `value`, in the same place where that is its length already.
    pub fn reset(&mut self, len: usize, value: T) {
        if self.len == len {
            self.fill(value);
        } else {
            *self = Self::new(len, value);
        }
    }
}

impl<T: Copy> Drop for Large<T> {
    fn drop(&mut self) {
        if let Some(layout) = self.layout {
            // SAFETY: allocated with this layout; T has nothing to drop.
            unsafe { dealloc(self.start.as_ptr().cast(), layout) };
        }
    }
}

// SAFETY: it owns what it points to, as a Vec does.
unsafe impl<T: Copy + Send> Send for Large<T> {}
// SAFETY: as above.
unsafe impl<T: Copy + Sync> Sync for Large<T> {}

impl<T: Copy> Deref for Large<T> {
    type Target = [T];
    #[inline(always)]
    fn deref(&self) -> &[T] {
        // SAFETY: `len` values were written there.
        unsafe { std::slice::from_raw_parts(self.start.as_ptr(), self.len) }
    }
}

impl<T: Copy> DerefMut for Large<T> {
    #[inline(always)]
    fn deref_mut(&mut self) -> &mut [T] {
        // SAFETY: as above.
        unsafe { std::slice::from_raw_parts_mut(self.start.as_ptr(), self.len) }
    }
}

impl<T: Copy> std::fmt::Debug for Large<T> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Large").field("len", &self.len).finish_non_exhaustive()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn holds_what_it_was_filled_with_at_any_size() {
        let mut buffer = Large::<u32>::default();
        assert!(buffer.is_empty());
        for len in [1, 0, 300_000, 300_000, 7] {
            buffer.reset(len, len as u32);
            assert!(buffer.len() == len && buffer.iter().all(|&v| v == len as u32));
            if let Some(last) = buffer.last_mut() {
                *last = 1;
            }
        }
        assert!(buffer[6] == 1 && buffer[0] == 7);
    }
}
