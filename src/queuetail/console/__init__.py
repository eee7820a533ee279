"""The operator's console: a web page and an API, served by the machine that runs queuetail."""
