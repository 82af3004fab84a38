defmodule Aerie.Vehicle.Snapshot.Arming do
  @moduledoc """
  What prevents a vehicle from arming: PX4's failing checks, ArduPilot's pre-arm texts, unhealthy sensors. Pure.
  """

  # ArduPilot repeats failing checks every 30 seconds.
  @fresh_us 40_000_000
  @complaint ~r/\A(?:pre-?arm|arm|preflight fail)\s*:\s*(.+)\z/i

  @typedoc "`:ready` nil: the vehicle does not report it. `:reasons` are texts for people, the latest first."
  @type t :: %{ready: boolean() | nil, armed: boolean() | nil, reasons: [String.t()]}

  @doc "From a vehicle's snapshot and its latest events."
  @spec of(map(), [map()], now :: integer()) :: t()
  def of(vehicle, events, now) do
    health = data(vehicle, :health)
    armed = data(vehicle, :mode)[:armed]
    ready = health[:ready_to_arm]

    reasons =
      if armed == true or ready == true,
        do: [],
        else: Enum.uniq(checks(health) ++ complaints(events, now) ++ sensors(health))

    %{ready: ready, armed: armed, reasons: reasons}
  end

  defp checks(health) do
    for check <- health[:arming_checks] || [],
        do: String.replace(check[:name] || "check #{check[:id]}", "_", " ")
  end

  defp complaints(events, now) do
    for %{type: "statustext", time: time, data: %{"text" => text} = data} <- Enum.reverse(events),
        not is_map_key(data, "component"),
        now - time <= @fresh_us,
        [_all, reason] <- [Regex.run(@complaint, text)],
        uniq: true,
        do: reason
  end

  defp sensors(health), do: for(name <- health[:unhealthy] || [], do: "#{sensor(name)} is unhealthy")

  @doc "A sensor's name for people: `3d_gyro` is `3D gyro`."
  @spec sensor(String.t()) :: String.t()
  def sensor("3d_" <> name), do: "3D " <> sensor(name)
  def sensor(name), do: String.replace(name, "_", " ")

  defp data(%{groups: groups}, group), do: get_in(groups, [group, :data]) || %{}
end
