defmodule Aerie.Fleet.Client.StateForm do
  @moduledoc """
  One vehicle as one flat object: the form of `state.sock` and of `GET /api/status`. Pure.

  ```json
  {"timestamp": 1713264000.123, "vehicle": "VID-001", "network": "main", "system_id": 1,
   "status": "online", "via": null, "age": 0.08,
   "fc_connected": true, "fc_port": "/dev/ttyS0", "fc_baud": 921600, "autopilot": "ardupilot", "type": "copter",
   "armed": false, "in_air": false, "mode": "STABILIZE",
   "attitude": {"roll": 0.02, "pitch": -0.01, "yaw": 178.5},
   "position": {"lat": 12.9716, "lon": 77.5946, "alt_msl": 920.0, "alt_rel": 0.0, "heading": 178.5},
   "velocity": {"groundspeed": 0.0, "airspeed": 0.0, "climb": 0.0},
   "battery": {"voltage": 22.8, "current": 0.5, "remaining": 0.98},
   "gps": {"fix": 3, "satellites": 14, "hdop": 0.9},
   "ages": {"attitude": 0.08, "position": 0.2, "velocity": 0.2, "battery": 0.6, "gps": 0.4}}
  ```

  Names, units and decimals are those of `Aerie.Vehicle.Fields`; `timestamp` is unix time in seconds. What is not known is
  null. `via` is the gateway by which a remote vehicle is reached, null for one on this gateway's links. `fc_connected` says
  whether the vehicle is heard; `age` how long ago it was heard, and `ages` how long ago each part of the state was: a value that is no longer reported stays, with its age. `fc_port` is the device or address of
  the link that it is heard on, `fc_baud` is null for other links than serial ones. The ages of a vehicle that is heard from
  a recording are those in the recording.
  """

  alias Aerie.Base.Json
  alias Aerie.Vehicle.Snapshot.Age
  alias Aerie.Vehicle.Fields
  alias Aerie.Vehicle.Snapshot

  @parts [
    attitude: [:roll, :pitch, :yaw],
    position: [:lat, :lon, :alt_msl, :alt_rel, :heading],
    velocity: [:groundspeed, :airspeed, :climb],
    battery: [:voltage, :current, :remaining],
    gps: [:fix, :satellites, :hdop]
  ]
  @doc "The object of a vehicle's snapshot at a unix time in microseconds; `links` are snapshots of links by id."
  @spec of(map(), %{optional(term()) => map()}, integer()) :: map()
  def of(vehicle, links, now) do
    mode = Snapshot.data(vehicle, :mode)
    heard_by = for id <- vehicle.links, link = links[id], do: link
    clock = Age.now(vehicle, heard_by, now)

    %{
      timestamp: Float.round(now / 1_000_000, 3),
      vehicle: vehicle.id,
      network: vehicle.network,
      system_id: vehicle.system_id,
      status: vehicle.status,
      via: vehicle.via,
      age: age(vehicle.last_heard, clock),
      fc_connected: vehicle.status == :online,
      autopilot: vehicle.autopilot,
      type: vehicle.vehicle_type,
      armed: mode[:armed],
      in_air: mode[:in_air],
      mode: text(mode[:mode]),
      ages: for({part, _keys} <- @parts, into: %{}, do: {part, age(at(vehicle, part), clock)})
    }
    |> Map.merge(port(vehicle.links, links))
    |> Map.merge(
      Map.new(@parts, fn {part, keys} -> {part, part(part, keys, Snapshot.data(vehicle, part))} end)
    )
  end

  @doc """
  The objects of all vehicles as lines of JSON, each with its line end. While there is no vehicle, one line says so: nothing
  is connected, and the rest is null.
  """
  @spec lines([map()], [map()], integer()) :: binary()
  def lines([], links, now), do: lines([%Snapshot{}], links, now)

  def lines(vehicles, links, now) do
    links = Map.new(links, &{&1.id, &1})
    vehicles |> Enum.map(&[Json.encode_to_iodata!(of(&1, links, now)), ?\n]) |> IO.iodata_to_binary()
  end

  defp part(group, keys, data) do
    shown = Fields.rounded(group, Map.take(data, keys))
    Map.new(keys, &{&1, number(shown[&1])})
  end

  # The latest link first.
  defp port([id | _], links) do
    case links do
      # An open serial port; its device and rate may have been found by searching.
      %{^id => %{baud: baud, local: local}} when baud != nil ->
        %{fc_port: local, fc_baud: baud}

      %{^id => %{spec: %{device: device, baud: baud}}} when device != nil ->
        %{fc_port: device, fc_baud: baud}

      %{^id => %{url: url}} ->
        %{fc_port: text(url), fc_baud: nil}

      _unknown ->
        %{fc_port: Json.plain(id), fc_baud: nil}
    end
  end

  defp port([], _links), do: %{fc_port: nil, fc_baud: nil}

  defp at(vehicle, group) do
    case vehicle.groups do
      %{^group => %{at: at}} -> at
      _unheard -> nil
    end
  end

  defp age(nil, _now), do: nil
  defp age(at, now), do: Float.round(max(now - at, 0) / 1_000_000, 2)

  defp number(value) when is_number(value), do: value
  defp number(_unknown), do: nil

  defp text(value) when is_binary(value), do: Json.text(value)
  defp text(_unknown), do: nil
end
