"""What several test modules share: small rooms, captures, views and finished runs."""
