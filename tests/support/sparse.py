"""What `.ci/run` leaves to the night, and `./dev test` to `.ci/run`: tests by what they cost, in
seconds of one core.

A test whose value is k runs every k-th of its cases, the first one first; 0: none. All cases run in
`.ci/nightly`. They repeat, over more cases or with more processes, what others hold.
"""

SPARSE = {
    # kills, interruptions, full disks: each command in turn; one case of each kind runs on every
    # change
    "replay/planner_process/test_apart.py::test_a_run_that_ends_takes_a_planner_along_that_hangs": 6,  # 83 s, 6 cases
    # 13 s, 3
    "replay/planner_process/test_apart.py::test_what_is_driven_does_not_depend_on_the_process": 3,
    # 31 s, 2
    "replay/planner_process/test_batch.py::test_the_numbers_are_those_of_logs_by_themselves": 2,
    "replay/planner_process/test_templates.py::test_a_run_in_a_worker_still_sees_what_is_not_deterministic": 2,  # 14 s, 2
    "replan/run/test_resume.py::test_a_resumed_run_gives_the_bytes_of_one_that_was_never_interrupted": 3,  # 64 s, 3
    # 14 s; a killed worker runs
    "replan/run/test_batch.py::test_a_killed_planner_costs_its_drives_only": 0,
    "replan/run/test_full_disk.py::test_a_worker_that_finds_a_full_disk_ends_it": 0,  # 13 s
    "replan/run/test_full_disk.py::test_a_run_ends_in_one_line_and_is_resumed": 4,  # 8 s, 4
    "replan/run/test_shards.py::test_merged_shards_are_the_run_byte_for_byte": 2,  # 11 s, 4
    "replan/run/test_shards.py::test_a_twin_that_is_known_late_costs_no_other_log": 2,  # 7 s, 2
    "replan/experiments/test_tune.py::test_pure_noise_fails": 0,
    # the command line from outside
    # 29 s, 2
    "replan/cli/test_streams.py::test_a_run_with_closed_streams_has_its_results_and_exit_code": 2,
    # 17 s, 5
    "replan/cli/test_streams.py::test_exit_codes_with_closed_streams_are_those_with_open_ones": 5,
    "replan/cli/test_exit_codes.py::test_exit_codes": 2,  # 39 s, 30
    "replan/cli/test_exit_codes.py::"
    # 12 s, 4
    "test_a_signal_before_and_in_a_command_ends_it_with_130_and_after_it_changes_nothing": 4,
    "replan/cli/test_sockets.py::test_system_calls_of_a_command_name_no_other_machine": 0,  # 22 s
    "replan/results/test_reading.py::test_edited_results_are_one_line_and_nothing_outside_is_written": 0,  # 113 s
    # 9 s
    "replan/draw/report/test_report.py::test_a_letter_that_the_encoding_lacks_is_replaced": 0,
    "house/test_ci.py::test_the_gitlab_jobs_drive_shards_and_the_merge_judges_and_so_does_githubs": 0,  # 25 s
    # many drives of one law
    "replan/paper/test_pedestrian_cases.py::test_the_laws_hold_over_the_table": 6,  # 123 s, 184
    "replan/explain/test_why.py::test_no_sentence_contradicts_the_numbers_anywhere": 3,  # 57 s, 34
    # 17 s, 22
    "replan/explain/test_explain.py::test_explain_states_a_decision_that_every_family_accepts": 3,
    "replay/loop/test_loops.py::test_on_recorded_logs_the_end_and_the_metric_say_the_same_of_fault": 3,  # 55 s, 3
    "replay/loop/test_determinism.py::test_who_is_dealt_other_plans_is_marked_with_time_and_size": 2,  # 9 s, 2
    "metrics/test_boxes.py::test_the_size_of_pieces_changes_no_bit": 3,  # 28 s, 12
    "logs/repair/test_offline.py::test_the_driver_of_the_log_meets_no_track": 3,  # 26 s, 13
    # 22 s
    "logs/repair/test_kernels.py::test_clean_recordings_and_the_catalogue_need_no_repair": 0,
    "logs/test_route.py::test_on_real_lane_graphs_too": 2,  # 9 s, 2
    "core/test_kernel_cache.py::test_a_changed_name_field_or_member_is_compiled_anew": 0,  # 13 s
    "core/test_kernel_cache.py::"
    # 10 s; .ci/run does it
    "test_code_beside_copied_sources_is_used_for_its_source_and_processor_only": 0,
    "studies/test_catalogue.py::test_smoke_runs": 0,  # 30 s
    "studies/test_roads.py::test_the_recorded_driver_makes_its_own_way_and_a_parked_one_does_not": 0,  # 18 s
}  # fmt: skip
"""On every change, by file and name: the k of the module docstring."""

LATER = {
    # the command line: a run or a process each
    "replan/cli/test_exit_codes.py::test_exit_codes": 7,  # 24 s, 48 cases
    "replan/cli/test_exit_codes.py::test_a_signal_before_and_in_a_command_ends_it_with_130_and_after_it_changes_nothing": 0,  # 4 s
    # 7 s
    "replan/cli/test_streams.py::test_exit_codes_with_closed_streams_are_those_with_open_ones": 0,
    "replan/cli/test_words.py::test_json_is_one_document_and_says_what_the_words_say": 4,  # 7 s, 11
    "replan/cli/test_export.py::test_a_run_is_written_whole_and_other_logs_are_named": 0,  # 4 s
    # 3 s
    "replan/cli/test_cli.py::test_log_planner_and_mode_choose_the_same_drives_in_every_command": 0,
    "replan/cli/test_cli.py::test_the_report_says_what_the_exit_code_says_and_why": 2,  # 5 s, 3
    "replan/cli/test_cli.py::test_without_out_the_folder_is_numbered": 0,  # 3 s
    "replan/cli/test_cli.py::test_view_of_results_opens_index_and_worst": 0,  # 2 s
    "replan/run/test_full_disk.py::test_a_run_ends_in_one_line_and_is_resumed": 0,  # 3 s
    "replan/run/test_full_disk.py::test_a_file_is_whole_or_not_there": 3,  # 3 s, 7
    # one law of all commands
    "replan/run/test_commands_hold.py::test_a_full_disk_says_which_command_helps": 6,  # 8 s, 27
    "replan/run/test_commands_hold.py::test_interrupted_it_is_whole_and_goes_on": 6,  # 6 s, 27
    "replan/run/test_commands_hold.py::test_run_again_it_gives_the_same_bytes": 6,  # 5 s, 27
    "replan/run/test_commands_hold.py::test_a_url_is_refused_at_once": 4,  # 8 s, 34
    "replan/run/test_commands_hold.py::test_results_are_never_an_output": 4,  # 4 s, 63
    "replan/run/test_commands_hold.py::test_a_second_command_at_the_same_time_is_refused": 4,  # 4 s, 35
    # 4 s, 34
    "replan/run/test_commands_hold.py::test_foreign_files_are_refused_and_left_as_they_are": 4,
    "replan/run/test_commands_hold.py::test_a_read_only_place_is_one_line": 4,  # 3 s, 33
    "replan/run/test_commands_hold.py::test_a_folder_of_another_command_is_refused": 4,  # 1 s, 12
    "replan/run/test_commands_hold.py::test_another_ending_is_refused": 4,  # 1 s, 15
    "replan/run/test_commands_hold.py::test_other_files_of_the_folder_are_left": 3,  # 1 s, 6
    "replan/mine/test_mine.py::test_the_tables_do_not_depend_on_the_workers": 0,  # 4 s
    "replay/planner_process/test_batch.py::test_a_fault_costs_the_log_that_it_is_of_or_each_is_named": 2,  # 3 s, 4
    "replay/planner_process/test_apart.py::test_processes_in_sessions_of_their_own_end_with_the_drive": 3,  # 3 s, 4
    "replay/planner_process/test_apart.py::test_threads_that_start_planners_at_once_share_one_launcher": 0,  # 2 s
    "replan/results/test_reading.py::test_a_folder_in_a_summary_is_a_plain_name": 4,  # 2 s, 8
    # pages and programs of the documentation; one run that is traced
    "house/test_docs.py::test_programs_and_settings_are_whole": 4,  # 8 s, 16
    # 9 s
    "house/test_architecture.py::test_the_way_of_one_log_is_the_files_that_the_page_lists": 0,
    "metrics/test_metric.py::test_a_metrics_page_says_all_about_it": 12,  # 14 s, 124
    # one law over the whole catalogue, or over all planners
    "replan/paper/test_pedestrian_cases.py::test_the_laws_hold": 2,  # 3 s, 15
    "replay/loop/test_plan_period.py::test_a_period_is_its_steps_one_after_the_other": 2,  # 2 s, 15
    "replan/score/test_navsim.py::test_extended_comfort_is_that_of_the_original": 0,  # 2 s
    "replay/control/test_controller_contract.py::test_two_drives_are_identical_and_hold_at_the_stop": 5,  # 1 s, 12
    "planners/test_driving.py::test_a_mirrored_world_gives_the_mirrored_plan": 5,  # 12 s, 66
    "planners/dp_qp/test_dp_qp.py::test_a_mirrored_world_has_the_mirrored_plan": 3,  # 5 s, 22
    "planners/dp_qp/test_dp_qp.py::test_a_moved_world_has_the_moved_plan": 3,  # 3 s, 22
    # 2 s, 18
    "planners/dp_qp/test_dp_qp.py::test_odd_starts_and_roads_give_a_plan_or_a_reason": 3,
    "planners/dp_qp/test_dp_qp.py::test_the_ego_stops_behind_a_standing_car_and_stays": 2,  # 2 s, 2
    "planners/dp_qp/test_memory.py::test_the_same_scene_and_memory_give_the_same_plan_and_memory": 2,  # 2 s, 2
    "planners/dp_qp/test_degenerate_scenes.py::test_an_obstacle_in_the_centre_of_the_turn_is_driven_round": 3,  # 2 s, 3
    # 1 s, 2
    "planners/dp_qp/test_degenerate_scenes.py::test_a_loop_beyond_a_full_turn_is_driven_round": 2,
    "planners/dp_qp/test_oncoming_lane.py::test_a_queue_is_not_overtaken": 0,  # 1 s
    # 1 s
    "planners/dp_qp/test_oncoming_lane.py::test_an_agent_that_waits_before_a_junction_is_not_passed": 0,
    "planners/dp_qp/test_moving_obstacles.py::test_a_follower_in_the_neighbouring_lane_need_not_brake_hard": 0,  # 2 s
    "planners/test_blind.py::test_a_drive_does_not_depend_on_how_often_it_is_planned": 2,  # 1 s, 6
    "planners/piecewise_jerk/test_piecewise_jerk.py::test_without_the_compiler_the_answers_are_the_same": 0,  # 1 s
    # 4 s, 22
    "planners/dp_qp/test_ties.py::test_plans_of_the_catalogue_do_not_depend_on_rounding": 4,
    # 3 s, 2
    "planners/dp_qp/test_moving_obstacles.py::test_no_agent_is_passed_near_a_waiting_place": 2,
    "planners/dp_qp/test_moving_obstacles.py::test_a_free_neighbouring_lane_is_borrowed_and_recorded": 0,  # 2 s
    "planners/dp_qp/speed/test_caps.py::test_the_chosen_order_costs_least_and_its_reason_states_the_gap": 2,  # 3 s, 2
    # 4 s, 4
    "planners/rules/test_planner_rules.py::test_a_large_gap_is_taken_and_a_small_one_not": 4,
    # 3 s, 4
    "planners/rules/test_planner_rules.py::test_the_ego_waits_for_a_pedestrian_and_goes_on": 4,
    "planners/rules/test_planner_rules.py::test_at_a_stop_sign_the_ego_comes_to_rest_once_and_goes": 2,  # 2 s, 4
    # 2 s, 8
    "planners/rules/test_planner_rules.py::test_red_stops_before_the_line_and_green_lets_go": 2,
    # 6 s, 55
    "logs/catalogue/test_grids.py::test_cells_build_are_clean_and_are_found_again_by_name": 3,
    "logs/catalogue/test_catalogue.py::test_building_is_deterministic_and_parameters_are_in_the_metadata": 3,  # 2 s, 22
    "logs/edit/test_transform.py::test_metrics_of_a_drive_do_not_change": 2,  # 2 s, 10
    "logs/edit/test_transform.py::test_mirroring_twice_is_the_identity": 3,  # 2 s, 22
    "metrics/test_health.py::test_the_catalogue_is_clean": 3,  # 3 s, 22
    "metrics/test_compare_rules.py::test_each_rule_judges_its_change": 4,  # 3 s, 11
    "metrics/test_metric.py::test_all_metrics_of_the_shortest_drives_have_a_value_or_a_reason": 3,  # 2 s, 10
    "metrics/test_nuplan.py::test_all_parts_equal_those_of_the_devkit_on_recorded_logs": 0,  # 1 s
    # 2 s, 6
    "metrics/test_reference_drivers.py::test_5_cm_of_noise_leave_verdicts_that_are_not_marginal": 3,
    "logs/readers/ros/test_drives.py::test_a_drive_is_chosen_where_the_clock_restarts": 3,  # 2 s, 6
    "logs/readers/ros/test_drives.py::test_poses_of_a_sensor_become_the_bases": 6,  # 2 s, 18
    "core/test_files.py::test_a_pipe_in_place_of_a_file_is_refused_in_one_line": 3,  # 2 s, 14
    "logs/test_forward.py::test_the_part_to_drive_is_the_first_that_goes_forward": 6,  # 2 s, 48
}  # fmt: skip
"""In `./dev test`, likewise; `.ci/run` runs all of their cases."""
