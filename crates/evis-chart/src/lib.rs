//! Speed against accuracy: a ladder of settings, each timed and each scored against truth, and what they look like.
