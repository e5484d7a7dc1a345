"""What `.ci/run` leaves to the night: tests by what they cost, in seconds of one core, and what still runs of them.

A test whose value is k runs every k-th of its cases on each change, the first one first; 0: none. All cases run in
`.ci/nightly`. They repeat, over more cases or with more processes, what others hold on every change.
"""

SPARSE = {
    # kills, interruptions, full disks: each command in turn; one case of each kind runs on every change
    "replay/planner_process/test_apart.py::test_a_run_that_ends_takes_a_planner_along_that_hangs": 6,  # 83 s, 6 cases
    "replay/planner_process/test_apart.py::test_what_is_driven_does_not_depend_on_the_process": 3,  # 13 s, 3
    "replay/planner_process/test_batch.py::test_the_numbers_are_those_of_logs_by_themselves": 2,  # 31 s, 2
    "replay/planner_process/test_templates.py::"
    "test_a_run_loads_it_twice_in_a_worker_and_still_sees_what_is_not_deterministic": 2,  # 14 s, 2
    "replay/run/test_resume.py::test_a_resumed_run_gives_the_bytes_of_one_that_was_never_interrupted": 3,  # 64 s, 3
    "replay/run/test_claim.py::test_a_full_disk_says_the_command_that_helps_and_it_does": 4,  # 61 s, 13
    "replay/run/test_claim.py::test_run_again_it_gives_the_same_bytes_and_leaves_nothing": 4,  # 49 s, 12
    "replay/run/test_batch.py::test_a_killed_planner_costs_its_drives_only": 0,  # 14 s; a killed worker runs
    "replay/run/test_full_disk.py::test_a_worker_that_finds_the_disk_full_ends_the_run": 0,  # 13 s
    "replay/run/test_full_disk.py::test_a_run_ends_in_one_line_and_is_resumed": 4,  # 8 s, 4
    "replay/run/test_shards.py::test_merged_shards_are_the_run_byte_for_byte": 2,  # 11 s, 4
    "replay/run/test_twins.py::test_a_twin_that_is_known_late_costs_no_other_log": 2,  # 7 s, 2
    "replay/experiments/test_diagnose.py::test_an_interrupted_diagnosis_that_is_resumed_has_the_same_bytes": 0,  # 26 s
    "replay/experiments/test_tune.py::test_pure_noise_fails_and_an_interrupted_search_ends_with_the_same_bytes": 0,
    "replay/experiments/test_falsify.py::test_an_interrupted_search_ends_with_the_same_bytes": 0,  # 9 s
    "replay/experiments/test_vary.py::test_the_same_bytes_whatever_the_number_of_workers": 0,  # of a run, it is held
    # the command line from outside
    "replay/cli/test_streams.py::test_a_run_with_closed_streams_has_its_results_and_exit_code": 2,  # 29 s, 2
    "replay/cli/test_streams.py::test_exit_codes_with_closed_streams_are_those_with_open_ones": 5,  # 17 s, 5
    "replay/cli/test_exit_codes.py::test_exit_codes": 2,  # 39 s, 30
    "replay/cli/test_exit_codes.py::"
    "test_a_signal_before_and_in_a_command_ends_it_with_130_and_after_it_changes_nothing": 4,  # 12 s, 4
    "replay/cli/test_sockets.py::test_system_calls_of_a_command_name_no_other_machine": 0,  # 22 s
    "replay/results/test_reading.py::test_edited_results_are_one_line_and_nothing_outside_is_written": 0,  # 113 s
    "replay/draw/report/test_terminal.py::test_an_encoding_that_lacks_a_letter_is_no_traceback": 0,  # 9 s
    "house/test_ci.py::test_the_gitlab_jobs_drive_shards_and_the_merge_judges_and_so_does_githubs": 0,  # 25 s
    # many drives of one law
    "replay/paper/test_pedestrian_cases.py::test_the_laws_hold_over_the_table": 6,  # 123 s, 184
    "replay/explain/test_why.py::test_no_sentence_contradicts_the_numbers_anywhere": 3,  # 57 s, 34
    "replay/explain/test_explain.py::test_explain_states_a_decision_that_every_family_accepts": 3,  # 17 s, 22
    "replay/loop/test_loops.py::test_on_recorded_logs_the_end_and_the_metric_say_the_same_of_fault": 3,  # 55 s, 3
    "replay/loop/test_determinism.py::test_who_is_dealt_other_plans_is_marked_with_time_and_size": 2,  # 9 s, 2
    "metrics/test_boxes.py::test_the_size_of_the_pieces_changes_no_bit": 3,  # 28 s, 12
    "logs/repair/test_offline.py::test_the_driver_of_the_log_meets_no_track": 3,  # 26 s, 13
    "logs/repair/test_kernels.py::test_clean_recordings_and_the_catalogue_need_no_repair": 0,  # 22 s
    "logs/test_route.py::test_on_real_lane_graphs_too": 2,  # 9 s, 2
    "logs/test_kernel.py::test_code_on_disk_is_stale_where_a_name_a_field_or_a_member_has_changed": 0,  # 13 s
    "logs/test_kernel.py::"
    "test_code_beside_the_sources_is_found_where_they_are_copied_and_only_what_it_is_for": 0,  # 10 s; .ci/run does it
    "studies/test_catalogue.py::test_smoke_runs": 0,  # 30 s
    "studies/test_roads.py::test_the_recorded_driver_makes_its_own_way_and_a_parked_one_does_not": 0,  # 18 s
}  # fmt: skip
"""For tests, by file and name: the k of the module docstring."""
