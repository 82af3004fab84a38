defmodule Aerie.Control.CommandExecutor.Observed do
  @moduledoc """
  A vehicle's snapshot as the executor wants it: `Aerie.Vehicle.Protocol.Vehicle`, and what of it was heard since the last time. Pure.

  The messages say what was heard, not the times of the groups: the mode's group is renewed by EXTENDED_SYS_STATE
  too, which says nothing about the mode.
  """

  alias Aerie.Vehicle.Protocol.Vehicle
  alias Aerie.Vehicle.Snapshot

  # Message id: HEARTBEAT, GLOBAL_POSITION_INT, MISSION_CURRENT, HIGH_LATENCY2, HOME_POSITION, EXTENDED_SYS_STATE.
  @told_by %{
    0 => [:mode],
    33 => [:position],
    42 => [:mission],
    235 => [:mode, :position],
    242 => [:home],
    245 => [:in_air, :vtol]
  }

  @max_checks 8
  # MAV_SEVERITY
  @error 3

  @typedoc "When each message was heard last, in the time of the frames."
  @type sources :: %{non_neg_integer() => integer()}

  @doc "A vehicle of which only this is known."
  @spec vehicle(map(), us :: {non_neg_integer(), non_neg_integer()}) :: Vehicle.t()
  def vehicle(snapshot, us) do
    struct!(
      %Vehicle{system: snapshot.system_id, autopilot: snapshot.autopilot, kind: snapshot.vehicle_type},
      Map.merge(changes(snapshot), %{component: snapshot.component || 1, us: us})
    )
  end

  @doc "The fields that a snapshot shows."
  @spec changes(map()) :: map()
  def changes(snapshot) do
    mode = Snapshot.data(snapshot, :mode)
    position = Snapshot.data(snapshot, :position)

    %{
      version: snapshot.mavlink_version || 2,
      mode: mode[:mode],
      armed: mode[:armed],
      in_air: mode[:in_air],
      vtol_state: mode[:vtol_state],
      lat: position[:lat],
      lon: position[:lon],
      alt_msl: position[:alt_msl],
      alt_rel: position[:alt_rel],
      heading: position[:heading],
      home: home(Snapshot.data(snapshot, :home)),
      mission_seq: Snapshot.data(snapshot, :mission)[:seq],
      arming_checks: checks(snapshot),
      gcs: snapshot.gcs[:failsafe_range],
      params: snapshot.params,
      gimbal_manager: snapshot.memory[:gimbal_manager],
      mode_names: snapshot.memory[:mode_names] || %{},
      standard_modes: snapshot.memory[:standard_modes] || %{}
    }
  end

  @doc "The times of a snapshot's messages."
  @spec sources(map()) :: sources()
  def sources(snapshot), do: snapshot.memory[:sources] || %{}

  @doc "The groups that were heard between two snapshots. Without EXTENDED_SYS_STATE the heartbeat tells whether it flies."
  @spec changed_groups(sources(), sources()) :: [Vehicle.group()]
  def changed_groups(before, now) do
    heard = for {id, groups} <- @told_by, now[id] != nil and now[id] != before[id], group <- groups, do: group
    if :mode in heard and not is_map_key(now, 245), do: Enum.uniq([:in_air | heard]), else: Enum.uniq(heard)
  end

  # Those of lower severity keep it from being armed in other modes only.
  defp checks(snapshot) do
    checks = Snapshot.data(snapshot, :health)[:arming_checks] || []

    for(%{name: "check_" <> _ = name, severity: level} <- checks, level <= @error, do: name)
    |> Enum.take(@max_checks)
  end

  defp home(%{lat: lat, lon: lon, alt_msl: alt}) when is_number(lat) and is_number(lon) and is_number(alt),
    do: %{lat: lat, lon: lon, alt_msl: alt}

  defp home(_unknown), do: nil
end
