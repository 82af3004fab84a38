defmodule Aerie.Vehicle.State.Groups.Operator do
  @moduledoc "Who is in charge of the vehicle: as the gateway knows it (`Aerie.Vehicle.Session.Core.Services`), and as CONTROL_STATUS says."
  import Bitwise

  alias Aerie.Vehicle.State.Group
  alias MavCodec.Enums.GcsControlStatusFlags
  alias MavCodec.Messages, as: M

  @manages_system GcsControlStatusFlags.value(:GCS_CONTROL_STATUS_FLAGS_SYSTEM_MANAGER)
  @takeover_allowed GcsControlStatusFlags.value(:GCS_CONTROL_STATUS_FLAGS_TAKEOVER_ALLOWED)

  use Group,
    name: :operator,
    title: "Who is in charge of the vehicle.",
    sampling: {:change, 10.0, %{}, 60.0},
    messages: [M.ControlStatus],
    fields: [
      {:name, :text, nil, "who alone commands it through the gateway; null for nobody", "`take_control`"},
      {:via, :text, nil, "by which way: nats, rest, elixir, mavlink", "`take_control`"},
      {:since, :time, nil, "since when", "`take_control`"},
      {:reason, :text, nil, "why it was taken over", "`take_control`"},
      {:offered_to, :text, nil, "who may take it without a reason; `*` for anybody", "`hand_over_control`"},
      {:system, 0, nil, "the ground station in control as the vehicle tells; 0 for none", "CONTROL_STATUS"},
      {:takeover_allowed, :boolean, nil, "whether the vehicle gives control to anyone who asks",
       "CONTROL_STATUS"}
    ]

  # The operator in control (X15); only the component that manages the system speaks for all of it.
  @impl Group
  def read(%M.ControlStatus{flags: flags} = m, _state, _at) when (flags &&& @manages_system) != 0,
    do: {[], operator: %{system: m.gcs_main, takeover_allowed: (flags &&& @takeover_allowed) != 0}}

  def read(%M.ControlStatus{}, _state, _at), do: {[], []}
end
