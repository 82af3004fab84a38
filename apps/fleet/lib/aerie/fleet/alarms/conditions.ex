defmodule Aerie.Fleet.Alarms.Conditions do
  @moduledoc """
  What is wrong now: from snapshots of vehicles and links, from the diagnosis, and from the gateway's own state. Pure.

  What the diagnosis judges (`Aerie.Fleet.Diagnosis`) is not judged a second time here.
  """

  alias Aerie.Fleet.Diagnosis.Condition
  alias Aerie.Fleet.Alarms.Core
  alias Aerie.Vehicle.Snapshot

  # Which conditions of the diagnosis are also alarms, and how severe.
  @diagnosed [:two_vehicles_one_id, :overload, :noisy_link, :hub_not_confirming, :tracks_failing]
  @silent "Its own failsafe acts now. Clear its way home, and look at the links: aerial, distance, power."
  @severities %{error: :critical, warning: :warning}

  @doc "Conditions of a vehicle's snapshot."
  @spec vehicle(map()) :: [Core.condition()]
  def vehicle(%{id: id} = vehicle) do
    mode = Snapshot.data(vehicle, :mode)
    flying? = mode[:armed] == true or mode[:in_air] == true
    emergency? = mode[:failsafe] == true and vehicle.status != :lost

    silent(vehicle.status, id, flying?) ++
      if emergency?,
        do: [
          condition(
            :emergency,
            id,
            :critical,
            "Vehicle reports an emergency",
            id,
            "Look at its mode and its texts, and clear its way."
          )
        ],
        else: []
  end

  defp silent(:lost, id, true),
    do: [condition(:vehicle, id, :critical, "Lost contact while armed", id, @silent)]

  defp silent(:lost, id, false), do: [condition(:vehicle, id, :notice, "Lost contact", id)]

  defp silent(:stale, id, true),
    do: [condition(:vehicle, id, :warning, "No contact while armed", id, @silent)]

  defp silent(_status, _id, _flying?), do: []

  @doc "Conditions of a link's snapshot."
  @spec link(map()) :: [Core.condition()]
  def link(%{status: status}) when status in [:up, :idle, :ended, :disabled], do: []

  def link(%{id: id, status: status} = link),
    do: [
      condition(
        :link,
        id,
        :warning,
        "Link #{id} is #{status}" <> if(link[:text], do: ": #{link.text}", else: ""),
        nil,
        "Look at the link's page: cable, address, radio."
      )
    ]

  @doc """
  Those of the diagnosis' conditions that are alarms: duplicate system ids, overload, damaged frames, a hub that stores
  nothing, tracks that cannot be written.
  """
  @spec diagnosed([Condition.t()]) :: [Core.condition()]
  def diagnosed(conditions) do
    for %{name: name, subject: subject, severity: severity, title: title} = condition <- conditions,
        name in @diagnosed,
        do: %{
          key: {name, subject},
          severity: severity(name, severity),
          text: title,
          vehicle: vehicle_of(subject),
          why: Enum.join(condition.evidence, "; "),
          mend: condition.mend
        }
  end

  # As when this gateway's own server stores nothing: no vehicle is in danger.
  defp severity(:hub_not_confirming, :error), do: :warning
  defp severity(_name, severity), do: @severities[severity]

  defp vehicle_of({:vehicle, id}), do: id
  defp vehicle_of(_other), do: nil

  @doc "Conditions of the gateway itself: its ids, and what keeps it from storing events (nil for nothing)."
  @spec gateway(%{:alarm => String.t() | nil, optional(atom()) => term()}, String.t() | nil, String.t() | nil) ::
          [Core.condition()]
  def gateway(identity, nats, audit) do
    for {kind, severity, text} <- [
          {:identity, :critical, identity.alarm},
          {:events, :warning, nats && "Events are not stored: #{nats}"},
          {:audit, :warning, audit && "Commands are refused: the audit log #{audit}"}
        ],
        text != nil,
        do: %{key: {kind, :gateway}, severity: severity, text: text, vehicle: nil}
  end

  defp condition(kind, id, severity, text, vehicle, mend \\ nil),
    do: %{key: {kind, id}, severity: severity, text: text, vehicle: vehicle, mend: mend}
end
