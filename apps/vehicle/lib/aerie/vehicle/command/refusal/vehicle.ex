defmodule Aerie.Vehicle.Command.Refusal.Vehicle do
  @moduledoc """
  How a command or a transfer ends that reached the vehicle, or could not: what the vehicle answered, and what is known
  of it otherwise (`Aerie.Vehicle.Command.Refusal`).
  """

  @restarted "restarted before its end was known"
  @stopped "the gateway was stopped while the command was under way"

  @ends [
    completed: [
      shown: "no acknowledgement came; its state shows it",
      shown_after_stop: @stopped <> "; the vehicle's state shows it now"
    ],
    accepted: [
      repeated: "it is repeated %{hz} times a second for %{ms} ms%{note}",
      shown_later: "its state will show it with its next summary",
      unverified: "the vehicle has no checksums by which to compare it",
      value_not_shown: "it accepted the value, and does not show it"
    ],
    rejected: [
      vehicle_unknown: "the vehicle is not known",
      vehicle_unheard: "the vehicle has not been heard yet",
      vehicle_lost: "the vehicle is lost",
      high_latency: "the vehicle is reached only by links of high latency",
      carried_out: "a command with this id is being carried out",
      waiting_many: "%{n} commands wait for this vehicle already",
      refused: "the vehicle refused it: %{why}",
      keeps: "the vehicle keeps the value %{value}",
      unsupported: "the component does not support this value",
      too_large: "it is larger than what is read",
      bad_path: "the path is empty, longer than 239 bytes, or has a NUL",
      answered_busy: "the vehicle answered TEMPORARILY_REJECTED",
      answered_form: "the vehicle answered %{result}, and there is no other way to say it",
      mavlink_1: "this vehicle speaks MAVLink 1, which has no %{lacking}; set its port to MAVLink 2",
      stored: "arm it first: %{command} now would move it as soon as it is armed",
      on_ground: "it is on the ground",
      home_height_unknown: "the height of its home is not known yet",
      mode_changed: "its mode was changed to %{mode} on the way",
      no_terrain: "it takes no heights above the ground below",
      no_command_line: "only Betaflight and iNav have a command line"
    ],
    failed: [
      answered: "the vehicle answered %{result}%{code}",
      not_shown: "the vehicle accepted it, but %{state}",
      rebooted: "the vehicle rebooted",
      rebooted_between: "the vehicle rebooted before the last step was sent",
      missing: "%{n} of them never came",
      too_many: "the vehicle says that it has %{n}, more than are read",
      changing: "the list changed each time that it was read",
      changed: "the file changed while it was read",
      damaged: "the vehicle's checksum is not that of what was written",
      not_set: "the component failed to set it",
      not_kept: "the component accepted the value and does not have it",
      not_all_set: "%{n} of %{of} were not set: %{shown}",
      no_metadata: "the vehicle does not say where metadata is (COMPONENT_METADATA)",
      no_plan: "what the vehicle has is not a valid plan: %{why}",
      no_parameter: "the vehicle's gateway did not answer with a parameter",
      file_damaged: "its checksum is not the vehicle's; it is removed: read it again",
      no_file_here: "the file cannot be written here: %{error}"
    ],
    cancelled: [
      cancelled_waiting: "cancelled before it was sent",
      cancelled_vehicle: "the vehicle stopped",
      rebooted_waiting: "the vehicle rebooted while it waited"
    ],
    timeout: [
      no_answer: "the vehicle does not answer",
      silent: "component %{component} does not answer: it is not there, or it has no such parameter",
      deadline: "its deadline passed before its end",
      no_end: "the vehicle accepted it but did not report the end",
      not_shown_yet: "%{answer}, and %{state}"
    ],
    unknown: [
      replaced: "%{command} took its place",
      ambiguous: "the acknowledgement may belong to the command it replaced",
      unacknowledged: "no acknowledgement came",
      repetition_refused: "a repetition was refused: %{why}",
      state_unheard: "%{answer}, and its state was not heard since",
      cancel_unanswered: "cancel was sent; the vehicle did not answer",
      rebooted_unknown: "the vehicle rebooted before the end was known",
      holder_changed: "another gateway may hold the vehicle now; no more was sent",
      lost: "the vehicle's processes were " <> @restarted,
      commands_restarted: "the gateway's commands were " <> @restarted,
      interrupted: "a fault in the gateway interrupted the command",
      gateway_ended: "the gateway ended before the end was known",
      gateway_stopped: @stopped <> "; it is not sent again",
      not_shown_after_stop: @stopped <> ", and the vehicle's state does not show it; it is not sent again",
      unshowable_after_stop:
        @stopped <> ", and nothing of the vehicle's state can show it; it is not sent again",
      no_result: "the gateway %{via} answered without a result",
      no_answer_in_time: "the gateway %{via} did not answer in time",
      no_progress: "the gateway %{via} reported no progress for %{minutes} minutes",
      gateway_silent: "the gateway %{via} fell silent while it was under way",
      nats_lost_meanwhile: "the connection to NATS was lost while it was under way",
      of_another_gateway: "the gateway %{by} had this command, and what became of it is not known here"
    ],
    expired: [
      expired: "its deadline has passed",
      expired_waiting: "its deadline passed while it waited",
      expired_between: "its deadline passed after %{done} of its steps; the last one was not sent",
      expired_form: "its deadline passed before it could be sent in the other form",
      waited: "other transfers with the vehicle were under way until it had to begin",
      yielded: "it made way for another transfer with the vehicle; try again"
    ]
  ]

  @doc "The texts by their reasons, for each status of a result."
  @spec ends() :: [{Aerie.Vehicle.Command.Result.status(), keyword(String.t())}]
  def ends, do: @ends
end
