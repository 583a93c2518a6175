//! JSON Schemas of all messages.
