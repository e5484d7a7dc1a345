"""Tests of which only some cases run on every change, by file and name.

They repeat, over more cases or with more processes, what others hold. `.ci/nightly` runs all of
them.
"""

from typing import NamedTuple


class Kept(NamedTuple):
    """Every k-th case of a test is kept, the first one first; with k = 0 none is.

    `cost_s` is what all its cases cost, in seconds of one core, where that is known.
    """

    k: int
    cost_s: int | None = None
    cases: int = 1


SPARSE = {
    # kills, interruptions, full disks: each command in turn; one case of each kind runs on every change
    "replay/planner_process/test_apart.py::test_a_run_that_ends_takes_a_planner_along_that_hangs": Kept(6, cost_s=83, cases=6),
    "replay/planner_process/test_apart.py::test_what_is_driven_does_not_depend_on_the_process": Kept(3, cost_s=13, cases=3),
    "replay/planner_process/test_batch.py::test_the_numbers_are_those_of_logs_by_themselves": Kept(2, cost_s=31, cases=2),
    "replay/planner_process/test_templates.py::test_a_run_in_a_worker_still_sees_what_is_not_deterministic": Kept(2, cost_s=14, cases=2),
    "replan/run/test_resume.py::test_a_resumed_run_gives_the_bytes_of_one_that_was_never_interrupted": Kept(3, cost_s=64, cases=3),
    "replan/run/test_batch.py::test_a_killed_planner_costs_its_drives_only": Kept(0, cost_s=14),
    "replan/run/test_full_disk.py::test_a_worker_that_finds_a_full_disk_ends_it": Kept(0, cost_s=13),
    "replan/run/test_full_disk.py::test_a_run_ends_in_one_line_and_is_resumed": Kept(4, cost_s=8, cases=4),
    "replan/run/test_shards.py::test_merged_shards_are_the_run_byte_for_byte": Kept(2, cost_s=11, cases=4),
    "replan/run/test_shards.py::test_a_twin_that_is_known_late_costs_no_other_log": Kept(2, cost_s=7, cases=2),
    "replan/experiments/test_tune.py::test_pure_noise_fails": Kept(0),
    # the command line from outside
    "replan/cli/test_streams.py::test_a_run_with_closed_streams_has_its_results_and_exit_code": Kept(2, cost_s=29, cases=2),
    "replan/cli/test_streams.py::test_exit_codes_with_closed_streams_are_those_with_open_ones": Kept(5, cost_s=17, cases=5),
    "replan/cli/test_exit_codes.py::test_exit_codes": Kept(2, cost_s=39, cases=30),
    "replan/cli/test_exit_codes.py::test_a_signal_before_and_in_a_command_ends_it_with_130_and_after_it_changes_nothing": Kept(4, cost_s=12, cases=4),
    "replan/cli/test_sockets.py::test_system_calls_of_a_command_name_no_other_machine": Kept(0, cost_s=22),
    "replan/results/test_reading.py::test_edited_results_are_one_line_and_nothing_outside_is_written": Kept(0, cost_s=113),
    "replan/draw/report/test_report.py::test_a_letter_that_the_encoding_lacks_is_replaced": Kept(0, cost_s=9),
    "house/test_ci.py::test_the_gitlab_jobs_drive_shards_and_the_merge_judges_and_so_does_githubs": Kept(0, cost_s=25),
    # many drives of one law
    "replan/paper/test_pedestrian_cases.py::test_the_laws_hold_over_the_table": Kept(6, cost_s=123, cases=184),
    "replan/explain/test_why.py::test_no_sentence_contradicts_the_numbers_anywhere": Kept(3, cost_s=57, cases=34),
    "replan/explain/test_explain.py::test_explain_states_a_decision_that_every_family_accepts": Kept(3, cost_s=17, cases=22),
    "replay/loop/test_loops.py::test_on_recorded_logs_the_end_and_the_metric_say_the_same_of_fault": Kept(3, cost_s=55, cases=3),
    "replay/loop/test_determinism.py::test_who_is_dealt_other_plans_is_marked_with_time_and_size": Kept(2, cost_s=9, cases=2),
    "metrics/test_boxes.py::test_the_size_of_pieces_changes_no_bit": Kept(3, cost_s=28, cases=12),
    "logs/repair/test_offline.py::test_the_driver_of_the_log_meets_no_track": Kept(3, cost_s=26, cases=13),
    "logs/repair/test_kernels.py::test_clean_recordings_and_the_catalogue_need_no_repair": Kept(0, cost_s=22),
    "logs/test_route.py::test_on_real_lane_graphs_too": Kept(2, cost_s=9, cases=2),
    "core/test_kernel_cache.py::test_a_changed_name_field_or_member_is_compiled_anew": Kept(0, cost_s=13),
    "core/test_kernel_cache.py::test_code_beside_copied_sources_is_used_for_its_source_and_processor_only": Kept(0, cost_s=10),
    "studies/test_catalogue.py::test_smoke_runs": Kept(0, cost_s=30),
    "studies/test_roads.py::test_the_recorded_driver_makes_its_own_way_and_a_parked_one_does_not": Kept(0, cost_s=18),
}  # fmt: skip
"""What `.ci/run` keeps of its tests; it leaves the other cases to the night."""

LATER = {
    # the command line: a run or a process each
    "replan/cli/test_exit_codes.py::test_exit_codes": Kept(7, cost_s=24, cases=48),
    "replan/cli/test_exit_codes.py::test_a_signal_before_and_in_a_command_ends_it_with_130_and_after_it_changes_nothing": Kept(0, cost_s=4),
    "replan/cli/test_streams.py::test_exit_codes_with_closed_streams_are_those_with_open_ones": Kept(0, cost_s=7),
    "replan/cli/test_json_output.py::test_json_is_one_document_with_the_names_of_the_words": Kept(4, cost_s=7, cases=11),
    "replan/cli/test_export.py::test_a_run_is_written_whole_and_other_logs_are_named": Kept(0, cost_s=4),
    "replan/cli/test_cli.py::test_log_planner_and_mode_choose_the_same_drives_in_every_command": Kept(0, cost_s=3),
    "replan/cli/test_cli.py::test_the_report_says_what_the_exit_code_says_and_why": Kept(2, cost_s=5, cases=3),
    "replan/cli/test_cli.py::test_without_out_the_folder_is_numbered": Kept(0, cost_s=3),
    "replan/cli/test_cli.py::test_view_of_results_opens_index_and_worst": Kept(0, cost_s=2),
    "replan/run/test_full_disk.py::test_a_run_ends_in_one_line_and_is_resumed": Kept(0, cost_s=3),
    "replan/run/test_full_disk.py::test_a_file_is_whole_or_not_there": Kept(3, cost_s=3, cases=7),
    # one law of all commands
    "replan/run/test_commands_hold.py::test_a_full_disk_says_which_command_helps": Kept(6, cost_s=8, cases=27),
    "replan/run/test_commands_hold.py::test_interrupted_it_is_whole_and_goes_on": Kept(6, cost_s=6, cases=27),
    "replan/run/test_commands_hold.py::test_run_again_it_gives_the_same_bytes": Kept(6, cost_s=5, cases=27),
    "replan/run/test_commands_hold.py::test_a_url_is_refused_at_once": Kept(4, cost_s=8, cases=34),
    "replan/run/test_commands_hold.py::test_results_are_never_an_output": Kept(4, cost_s=4, cases=63),
    "replan/run/test_commands_hold.py::test_a_second_command_at_the_same_time_is_refused": Kept(4, cost_s=4, cases=35),
    "replan/run/test_commands_hold.py::test_foreign_files_are_refused_and_left_as_they_are": Kept(4, cost_s=4, cases=34),
    "replan/run/test_commands_hold.py::test_a_read_only_place_is_one_line": Kept(4, cost_s=3, cases=33),
    "replan/run/test_commands_hold.py::test_a_folder_of_another_command_is_refused": Kept(4, cost_s=1, cases=12),
    "replan/run/test_commands_hold.py::test_another_ending_is_refused": Kept(4, cost_s=1, cases=15),
    "replan/run/test_commands_hold.py::test_other_files_of_the_folder_are_left": Kept(3, cost_s=1, cases=6),
    "replan/mine/test_mine.py::test_the_tables_do_not_depend_on_the_workers": Kept(0, cost_s=4),
    "replay/planner_process/test_batch.py::test_a_fault_costs_the_log_that_it_is_of_or_each_is_named": Kept(2, cost_s=3, cases=4),
    "replay/planner_process/test_apart.py::test_processes_in_sessions_of_their_own_end_with_the_drive": Kept(3, cost_s=3, cases=4),
    "replay/planner_process/test_apart.py::test_threads_that_start_planners_at_once_share_one_launcher": Kept(0, cost_s=2),
    "replan/results/test_reading.py::test_a_folder_in_a_summary_is_a_plain_name": Kept(4, cost_s=2, cases=8),
    # pages and programs of the documentation; one run that is traced
    "house/test_docs.py::test_programs_and_settings_are_whole": Kept(4, cost_s=8, cases=16),
    "house/test_architecture.py::test_the_way_of_one_log_is_the_files_that_the_page_lists": Kept(0, cost_s=9),
    "metrics/test_metric.py::test_a_metrics_page_says_all_about_it": Kept(12, cost_s=14, cases=124),
    # one law over the whole catalogue, or over all planners
    "replan/paper/test_pedestrian_cases.py::test_the_laws_hold": Kept(2, cost_s=3, cases=15),
    "replay/loop/test_plan_period.py::test_a_period_is_its_steps_one_after_the_other": Kept(2, cost_s=2, cases=15),
    "replan/score/test_navsim.py::test_extended_comfort_is_that_of_the_original": Kept(0, cost_s=2),
    "replay/control/test_controller_contract.py::test_two_drives_are_identical_and_hold_at_the_stop": Kept(5, cost_s=1, cases=12),
    "planners/test_driving.py::test_a_mirrored_world_gives_the_mirrored_plan": Kept(5, cost_s=12, cases=66),
    "planners/dp_qp/test_dp_qp.py::test_a_mirrored_world_has_the_mirrored_plan": Kept(3, cost_s=5, cases=22),
    "planners/dp_qp/test_dp_qp.py::test_a_moved_world_has_the_moved_plan": Kept(3, cost_s=3, cases=22),
    "planners/dp_qp/test_dp_qp.py::test_odd_starts_and_roads_give_a_plan_or_a_reason": Kept(3, cost_s=2, cases=18),
    "planners/dp_qp/test_dp_qp.py::test_the_ego_stops_behind_a_standing_car_and_stays": Kept(2, cost_s=2, cases=2),
    "planners/dp_qp/test_memory.py::test_the_same_scene_and_memory_give_the_same_plan_and_memory": Kept(2, cost_s=2, cases=2),
    "planners/dp_qp/test_degenerate_scenes.py::test_an_obstacle_in_the_centre_of_the_turn_is_driven_round": Kept(3, cost_s=2, cases=3),
    "planners/dp_qp/test_degenerate_scenes.py::test_a_loop_beyond_a_full_turn_is_driven_round": Kept(2, cost_s=1, cases=2),
    "planners/dp_qp/test_oncoming_lane.py::test_a_queue_is_not_overtaken": Kept(0, cost_s=1),
    "planners/dp_qp/test_oncoming_lane.py::test_an_agent_that_waits_before_a_junction_is_not_passed": Kept(0, cost_s=1),
    "planners/dp_qp/test_moving_obstacles.py::test_a_follower_in_the_neighbouring_lane_need_not_brake_hard": Kept(0, cost_s=2),
    "planners/test_blind.py::test_a_drive_does_not_depend_on_how_often_it_is_planned": Kept(2, cost_s=1, cases=6),
    "planners/piecewise_jerk/test_piecewise_jerk.py::test_without_the_compiler_the_answers_are_the_same": Kept(0, cost_s=1),
    "planners/dp_qp/test_ties.py::test_plans_of_the_catalogue_do_not_depend_on_rounding": Kept(4, cost_s=4, cases=22),
    "planners/dp_qp/test_moving_obstacles.py::test_no_agent_is_passed_near_a_waiting_place": Kept(2, cost_s=3, cases=2),
    "planners/dp_qp/test_moving_obstacles.py::test_a_free_neighbouring_lane_is_borrowed_and_recorded": Kept(0, cost_s=2),
    "planners/dp_qp/speed/test_caps.py::test_the_chosen_order_costs_least_and_its_reason_states_the_gap": Kept(2, cost_s=3, cases=2),
    "planners/rules/test_planner_rules.py::test_a_large_gap_is_taken_and_a_small_one_not": Kept(4, cost_s=4, cases=4),
    "planners/rules/test_planner_rules.py::test_the_ego_waits_for_a_pedestrian_and_goes_on": Kept(4, cost_s=3, cases=4),
    "planners/rules/test_planner_rules.py::test_at_a_stop_sign_the_ego_comes_to_rest_once_and_goes": Kept(2, cost_s=2, cases=4),
    "planners/rules/test_planner_rules.py::test_red_stops_before_the_line_and_green_lets_go": Kept(2, cost_s=2, cases=8),
    "logs/catalogue/test_grids.py::test_cells_build_are_clean_and_are_found_again_by_name": Kept(3, cost_s=7, cases=64),
    "logs/catalogue/test_catalogue.py::test_building_is_deterministic_and_parameters_are_in_the_metadata": Kept(3, cost_s=3, cases=31),
    "logs/edit/test_transform.py::test_metrics_of_a_drive_do_not_change": Kept(2, cost_s=2, cases=10),
    "logs/edit/test_transform.py::test_mirroring_twice_is_the_identity": Kept(3, cost_s=2, cases=22),
    "metrics/test_health.py::test_the_catalogue_is_clean": Kept(3, cost_s=3, cases=22),
    "metrics/test_compare_rules.py::test_each_rule_judges_its_change": Kept(4, cost_s=3, cases=11),
    "metrics/test_metric.py::test_all_metrics_of_the_shortest_drives_have_a_value_or_a_reason": Kept(3, cost_s=2, cases=10),
    "metrics/test_nuplan.py::test_all_parts_equal_those_of_the_devkit_on_recorded_logs": Kept(0, cost_s=1),
    "metrics/test_reference_drivers.py::test_5_cm_of_noise_leave_verdicts_that_are_not_marginal": Kept(3, cost_s=2, cases=6),
    "logs/readers/ros/test_drives.py::test_a_drive_is_chosen_where_the_clock_restarts": Kept(3, cost_s=2, cases=6),
    "logs/readers/ros/test_drives.py::test_poses_of_a_sensor_become_the_bases": Kept(6, cost_s=2, cases=18),
    "core/test_files.py::test_a_pipe_in_place_of_a_file_is_refused_in_one_line": Kept(3, cost_s=2, cases=14),
    "logs/test_forward.py::test_the_part_to_drive_is_the_first_that_goes_forward": Kept(6, cost_s=2, cases=48),
}  # fmt: skip
"""What `./dev test` keeps of its tests; it leaves the other cases to `.ci/run`."""
