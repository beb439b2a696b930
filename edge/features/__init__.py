"""Features of a station: each is a stage of a press, and brings what only it uses. The contract is `press_stage`."""
