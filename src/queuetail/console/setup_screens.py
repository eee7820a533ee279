"""Set up, Accuracy check and History: their pages and routes, as the application adds them."""

from __future__ import annotations

from queuetail.console import (
    check_api,
    check_page,
    history_api,
    history_page,
    setup_api,
    setup_moments,
    setup_page,
    sliders_api,
)

ROUTES = (setup_moments, check_api, setup_api, sliders_api, history_api)
PAGES = (setup_page.add, check_page.add, history_page.add)
