defmodule Aerie.Console.Pages.Vehicle.Charts.Series do
  @moduledoc "The fields of a vehicle's state that can be charted, and a sample of chosen ones. Pure."

  alias Aerie.Vehicle.Snapshot

  @max 8
  @fresh_us 5_000_000
  @axes ~w(x y z)
  @channels 18

  @typedoc "`:key` identifies it in addresses and files: `battery.voltage`, `health.ekf.compass`, `health.vibration.x`."
  @type t :: %{
          key: String.t(),
          label: String.t(),
          unit: String.t(),
          meaning: String.t(),
          path: [atom() | non_neg_integer()] | tuple()
        }

  # Better labels than the names of the state.
  labels = %{
    "position.lat" => "Latitude",
    "position.lon" => "Longitude",
    "position.alt_msl" => "Altitude (MSL)",
    "position.alt_rel" => "Height (above home)",
    "position.heading" => "Heading",
    "attitude.roll" => "Roll",
    "attitude.pitch" => "Pitch",
    "attitude.yaw" => "Yaw",
    "attitude.rollspeed" => "Roll rate",
    "attitude.pitchspeed" => "Pitch rate",
    "attitude.yawspeed" => "Yaw rate",
    "velocity.vn" => "Velocity north",
    "velocity.ve" => "Velocity east",
    "velocity.vd" => "Velocity down",
    "velocity.groundspeed" => "Ground speed",
    "velocity.airspeed" => "Airspeed",
    "velocity.climb" => "Climb rate",
    "velocity.throttle" => "Throttle",
    "battery.consumed_mah" => "Battery used",
    "battery.remaining" => "Battery remaining",
    "gps.lat" => "GPS latitude",
    "gps.lon" => "GPS longitude",
    "gps.alt_msl" => "GPS altitude (MSL)",
    "gps.h_acc" => "GPS horizontal accuracy",
    "gps.v_acc" => "GPS vertical accuracy",
    "gps.hdop" => "GPS HDOP",
    "gps.vdop" => "GPS VDOP",
    "home.lat" => "Home latitude",
    "home.lon" => "Home longitude",
    "home.alt_msl" => "Home altitude (MSL)",
    "mission.seq" => "Mission item",
    "mission.total" => "Mission items",
    "mission.reached" => "Mission item reached",
    "mission.wp_distance" => "Distance to mission item",
    "rc.rssi" => "RC signal strength"
  }

  words = fn names ->
    names
    |> Enum.join(" ")
    |> String.replace("_", " ")
    |> String.capitalize()
    |> String.replace(~r/\A(Gps|Rc)\b/, &String.upcase/1)
    |> String.replace(" ekf ", " EKF ")
  end

  fields =
    for {group, _title, fields} <- Snapshot.groups(),
        %{path: path, decimals: decimals} = field when decimals != nil <- fields,
        hd(path) not in [:batteries, :arming_checks],
        do: {group, field}

  all =
    Enum.flat_map(fields, fn {group, %{path: path} = field} ->
      parts =
        case {group, path} do
          {:health, [:vibration]} -> for {axis, i} <- Enum.with_index(@axes), do: {axis, i}
          {:rc, [:channels]} -> for i <- 1..@channels, do: {"#{i}", i - 1}
          _plain -> [nil]
        end

      for part <- parts do
        names = [group | path] |> Enum.map(&Atom.to_string/1)
        {names, path} = if part, do: {names ++ [elem(part, 0)], path ++ [elem(part, 1)]}, else: {names, path}

        %{
          key: Enum.join(names, "."),
          label: Map.get(labels, Enum.join(names, "."), words.(names)),
          unit: field.unit || "",
          meaning: field.meaning,
          path: [group | path]
        }
      end
    end)

  @all all
  @by_key Map.new(all, &{&1.key, &1})

  @doc "All series, in the order of the documentation."
  @spec all() :: [t()]
  def all, do: @all

  @doc "The largest number of charts on a page."
  @spec max() :: pos_integer()
  def max, do: @max

  @doc "The series of a list of keys from outside, at most #{@max}; `other` looks up keys that are not of the state. Unknown ones are left out."
  @spec choose([String.t()], other :: (String.t() -> t() | nil)) :: [t()]
  def choose(keys, other \\ fn _key -> nil end),
    do:
      for(key <- keys |> Enum.uniq() |> Enum.take(@max), %{} = one <- [@by_key[key] || other.(key)], do: one)

  @doc "The present values by key; null if not known or too old."
  @spec sample(map(), [t()], integer()) :: %{String.t() => number() | nil}
  def sample(vehicle, series, now), do: Map.new(series, &{&1.key, value(vehicle.groups, &1.path, now)})

  # What the gateway's tracks have of a vehicle (`Aerie.Fleet.tracks/6`), and their names there.
  @tracked %{
    "position.lat" => :lat,
    "position.lon" => :lon,
    "position.alt_rel" => :height,
    "position.heading" => :heading,
    "velocity.groundspeed" => :speed,
    "battery.remaining" => :battery
  }

  @doc "Whether the gateway's tracks have it, from before a page was opened."
  @spec tracked?(t()) :: boolean()
  def tracked?(%{key: key}), do: is_map_key(@tracked, key)

  @presets [
    {"Flight", ~w(position.alt_rel velocity.groundspeed velocity.climb)},
    {"Battery", ~w(battery.voltage battery.current battery.remaining)},
    {"Attitude", ~w(attitude.roll attitude.pitch attitude.yaw)},
    {"Vibration", ~w(health.vibration.x health.vibration.y health.vibration.z)},
    {"Link", ~w(link.frames_per_s link.bytes_per_s health.drop_rate)}
  ]

  @doc "Choices that are often needed: a name and its keys."
  @spec presets() :: [{String.t(), [String.t()]}]
  def presets, do: @presets

  @doc "What samples of the tracks have of these series: the time in seconds, and the values by key, null where old."
  @spec history([map()], [t()]) :: [{float(), %{String.t() => number() | nil}}]
  def history(samples, series) do
    tracked = Map.take(@tracked, Enum.map(series, & &1.key))

    for %{at: at} = sample <- samples, tracked != %{} do
      fresh? = sample.age != nil and sample.age * 1_000_000 <= @fresh_us
      {at / 1_000_000, Map.new(tracked, fn {key, name} -> {key, if(fresh?, do: sample[name])} end)}
    end
  end

  @doc "Whether a value that was heard at `at` is recent enough for a chart."
  @spec fresh?(integer(), integer()) :: boolean()
  def fresh?(at, now), do: now - at <= @fresh_us

  defp value(groups, [group | path], now) do
    with %{at: at, data: data} <- groups[group],
         true <- fresh?(at, now),
         number when is_number(number) <- Enum.reduce(path, data, &part/2),
         do: number,
         else: (_none -> nil)
  end

  defp part(_name, nil), do: nil
  defp part(index, list) when is_list(list), do: Enum.at(list, index)
  defp part(name, %{} = map), do: Map.get(map, name)
  defp part(_name, _other), do: nil
end
