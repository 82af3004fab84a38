defmodule Aerie.Vehicle.State.Groups.Mission do
  @moduledoc "Mission progress and fence."

  alias Aerie.Vehicle.State.{Group, Value}
  alias MavCodec.Enums.{FenceBreach, MissionState}
  alias MavCodec.Messages, as: M

  use Group,
    name: :mission,
    title: "Mission progress and fence.",
    sampling: {:change, 1.0, %{}, 60.0},
    messages: [M.MissionCurrent, M.MissionItemReached, M.NavControllerOutput, M.FenceStatus],
    fields: [
      {:seq, 0, nil, "the current item", "MISSION_CURRENT, HIGH_LATENCY2"},
      {:total, 0, nil, "number of items", "MISSION_CURRENT"},
      {:state, :text, nil, "MISSION_STATE", "MISSION_CURRENT"},
      {:reached, 0, nil, "the last item that was reached", "MISSION_ITEM_REACHED"},
      {:wp_distance, 0, "m", "distance to the current item", "NAV_CONTROLLER_OUTPUT, HIGH_LATENCY2"},
      {:fence_breach, :boolean, nil, "true while the vehicle breaches its fence",
       "FENCE_STATUS, HIGH_LATENCY2"},
      {:fence_breach_type, :text, nil, "FENCE_BREACH", "FENCE_STATUS"}
    ]

  @impl Group
  def read(%M.MissionCurrent{} = m, _state, _at) do
    {[], mission: %{seq: Value.unsigned(m.seq, 16), total: total(m), state: mission_state(m.mission_state)}}
  end

  def read(%M.MissionItemReached{} = m, _state, _at), do: {[], mission: %{reached: Value.unsigned(m.seq, 16)}}

  def read(%M.NavControllerOutput{} = m, _state, _at) do
    {[], mission: %{wp_distance: Value.unsigned(m.wp_dist, 16)}}
  end

  def read(%M.FenceStatus{} = m, _state, _at) do
    {[], mission: %{fence_breach: m.breach_status != 0, fence_breach_type: breach(m)}}
  end

  @doc "The state of a breach while the fence is off: unknown."
  @spec fence_unknown() :: map()
  def fence_unknown, do: %{fence_breach: nil, fence_breach_type: nil}

  # The extension fields are zero if the sender does not know them (MAVLink 1, older firmware).
  defp total(%{total: 0, mission_state: 0}), do: nil
  defp total(%{total: total}), do: Value.unsigned(total, 16)

  defp mission_state(0), do: nil
  defp mission_state(value), do: MissionState.label(value) || "STATE(#{value})"

  defp breach(%{breach_type: 0}), do: nil
  defp breach(%{breach_type: type}), do: FenceBreach.label(type) || "BREACH(#{type})"
end
