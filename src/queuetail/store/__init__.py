"""Flights, their ends of queue over time and their events, kept in SQLite or PostgreSQL."""
