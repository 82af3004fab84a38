defmodule Aerie.Vehicle.Snapshot.Fields do
  @moduledoc """
  What is shown of a vehicle: each field once, with its type, unit and meaning. `show/3` renders it for three readers,
  whose JSON Schemas and tables in `docs/telemetry.md` are made of the same rows:

    * `:short` - `state.sock`
    * `:listed` - `GET /api/status` and `GET /api/vehicles`
    * `:whole` - `GET /api/vehicles/ID`

  The fields of a part (`clock`, `gcs`, `streams` …) stand where the part is made, those of a group of the state in
  its module. A new field is a row here or there; what has another form in a snapshot has a clause of `value/3`.
  """

  alias Aerie.Base.Json
  alias Aerie.Base.Json.{Object, Schema}
  alias Aerie.Vehicle.Firmware
  alias Aerie.Vehicle.State.Fields
  alias Aerie.Vehicle.Snapshot
  alias Aerie.Vehicle.Snapshot.Readiness
  alias Aerie.Vehicle.Snapshot.Readiness.Points
  alias Aerie.Vehicle.Services.{Gcs, Reports, Timesync}
  alias Aerie.Vehicle.Services.Streams.WantedMessage
  alias Aerie.Vehicle.State.Groups

  @typedoc """
  `:now` - unix microseconds; `:links` - the snapshots of the gateway's links by id; `:tags` - the tags of all
  vehicles by id and `:readiness` - their readiness, which the short form does not need
  """
  @type context :: %{
          required(:now) => integer(),
          required(:links) => %{optional(term()) => map()},
          optional(:tags) => %{String.t() => [String.t()]},
          optional(:readiness) => %{String.t() => Readiness.t()}
        }
  @type form :: :short | :listed | :whole

  @parts [
    attitude: [:roll, :pitch, :yaw],
    position: [:lat, :lon, :alt_msl, :alt_rel, :heading],
    velocity: [:groundspeed, :airspeed, :climb],
    battery: [:voltage, :current, :remaining],
    gps: [:fix, :satellites, :hdop]
  ]
  @part_names Keyword.keys(@parts)

  parts =
    for {name, keys} <- @parts, %{name: ^name, fields: fields} <- Groups.all() do
      rows =
        for %{path: [key]} = field <- fields,
            key in keys,
            do: {key, field.decimals, field.unit, field.meaning}

      {name, {:object, Object.fields(rows)}, nil, "of the group `#{name}`:"}
    end

  ages = for name <- @part_names, do: {name, 2, "s", "since `#{name}` was heard"}

  # What a group has besides its data.
  @group [
    {:time, :time, nil, "when its last message came", :at},
    {:age, 2, "s", "how long ago that is"},
    {:via, :text, nil, "the gateway that reported it; null: a link of this one"},
    {:time_boot_ms, :integer, "ms", "the vehicle's own clock then"}
  ]

  groups =
    for group <- Groups.all(), into: %{} do
      rows = @group ++ [{:data, {:schema, Fields.Schema.group(group)}, nil, group.title}]
      {group.name, rows |> Object.fields() |> Object.schema()}
    end

  collision = [
    {:time, :time, nil, "when it was noticed", :at},
    {:sign, :text, nil, "by what"},
    {:links, {:list, {:list, :text}}, nil, "the links of the one and of the other"}
  ]

  high_latency = [
    {:only, :boolean, nil, "whether only such links reach the vehicle",
     from: :only?,
     metric: {"gateway_vehicle_high_latency", "1 while it is reached by links of high latency only."}},
    {:links, {:list, :text}, nil, "ids of these links"}
  ]

  short =
    [
      {:timestamp, 3, "s", "unix time of the answer"},
      {:vehicle, :text, nil, "public name; null in the only line of `state.sock` while there is no vehicle",
       :id},
      {:network, :text, nil, "the network that its system id belongs to"},
      {:system_id, :integer, nil, "MAVLink system id"},
      {:status, {:one_of, [:online, :stale, :lost]}, nil, "online, stale or lost"},
      {:via, :text, nil, "the gateway by which it is reached; null: a link of this one (fleet.md)"},
      {:age, 2, "s", "since the vehicle was last heard"},
      {:fc_connected, :boolean, nil, "true while the vehicle is online"},
      {:fc_port, :text, nil, "device or address of the link that last heard it"},
      {:fc_baud, :integer, "1/s", "baud rate of a serial link"},
      {:autopilot, {:one_of, Enum.sort(Map.keys(Firmware.by_text()))}, nil, "its firmware"},
      {:type, :text, nil, "copter, plane, rover, …", :vehicle_type},
      {:armed, :boolean, nil, "as in the group `mode`"},
      {:in_air, :boolean, nil, "as in the group `mode`"},
      {:mode, :text, nil, "as in the group `mode`"}
    ] ++ parts ++ [{:ages, {:object, Object.fields(ages)}, nil, "the age of each of these five:"}]

  listed = [
    {:recording, {:object, MavRouter.Recorder.fields()}, nil, "how it is recorded (recordings.md):"},
    {:tags, {:list, :text}, nil, "words that people gave it (shadow.md)"},
    {:gateways, {:list, :text}, nil, "the other gateways that report it"},
    {:readiness, {:one_of, Points.states()}, nil,
     "whether it is ready to take off, with reasons in `GET /api/vehicles/ID/readiness` (fleet.md)"}
  ]

  whole = [
    {:groups, {:schema, Schema.object(groups, [], open: true)}, nil,
     "all state groups: `time`, `age`, `via`, `time_boot_ms`, `data`"},
    {:firmware, :text, nil, "firmware version"},
    {:capabilities, :integer, nil, "MAV_PROTOCOL_CAPABILITY flags"},
    {:uid, :text, nil, "unique id of the hardware"},
    {:component, :integer, nil, "component id of the autopilot"},
    {:time_boot_ms, :integer, "ms", "the vehicle's clock when last heard"},
    {:last_heard, :time, nil, "time of the last frame"},
    {:links, {:list, :text}, nil, "ids of the links that hear it, the latest first"},
    {:collision, {:object, Object.fields(collision)}, nil, "while two vehicles use the id:"},
    {:signing, {:object, MavRouter.Signing.fields()}, nil,
     "state of signing, if there is a key (signing.md):"},
    {:streams, {:list, {:object, WantedMessage.fields()}}, nil, "a list of the messages that are wanted:"},
    {:gcs, {:object, Gcs.fields()}, nil, "ground stations, and the vehicle's failsafe for a lost one:"},
    {:clock, {:object, Timesync.fields()}, nil, "the vehicle's clock, by TIMESYNC:"},
    {:reports, {:object, Reports.fields()}, nil, "PX4's reports (EVENT):"},
    {:high_latency, {:object, Object.fields(high_latency)}, nil, "high-latency links (satellites):"}
  ]

  @group_fields Object.fields(@group)
  @short Object.fields(short)
  @listed @short ++ Object.fields(listed)
  @whole @listed ++ Object.fields(whole)

  @doc "The fields of a form."
  @spec of(form()) :: [Object.t()]
  def of(:short), do: @short
  def of(:listed), do: @listed
  def of(:whole), do: @whole

  @doc "A vehicle in a form. What is not known is null; a value that no longer comes stays, with its age."
  @spec show(Snapshot.t(), form(), context()) :: %{atom() => term()}
  def show(vehicle, form, %{links: links, now: now} = context) do
    heard_by = for id <- vehicle.links, link = links[id], do: link
    context = Map.put(context, :clock, Snapshot.now(vehicle, heard_by, now))
    Map.new(of(form), &{&1.name, value(&1, vehicle, context)})
  end

  defp value(%{name: :timestamp}, _vehicle, at), do: Float.round(at.now / 1_000_000, 3)
  defp value(%{name: :age}, vehicle, at), do: age(vehicle.last_heard, at.clock)
  defp value(%{name: :fc_connected}, vehicle, _at), do: vehicle.status == :online
  defp value(%{name: :fc_port}, vehicle, at), do: vehicle.links |> port(at.links) |> elem(0)
  defp value(%{name: :fc_baud}, vehicle, at), do: vehicle.links |> port(at.links) |> elem(1)

  defp value(%{name: name}, vehicle, _at) when name in [:armed, :in_air],
    do: Snapshot.data(vehicle, :mode)[name]

  defp value(%{name: :mode}, vehicle, _at), do: text(Snapshot.data(vehicle, :mode)[:mode])
  defp value(%{name: :tags}, vehicle, at), do: Map.get(at.tags, vehicle.id, [])

  defp value(%{name: :readiness}, vehicle, at), do: get_in(at, [:readiness, vehicle.id, :state])

  defp value(%{name: :ages}, vehicle, at),
    do: Map.new(@part_names, &{&1, age(vehicle.groups[&1][:at], at.clock)})

  defp value(%{name: name, type: {:object, fields}}, vehicle, _at) when name in @part_names,
    do: Object.show(fields, Snapshot.data(vehicle, name))

  defp value(%{name: :groups}, vehicle, at),
    do: Map.new(vehicle.groups, fn {name, group} -> {name, group(name, group, at.clock)} end)

  defp value(%{name: :streams} = field, %{streams: %{} = streams} = vehicle, _at) do
    lines = for {id, line} <- Enum.sort(streams), do: Map.put(line, :id, id)
    Object.value(field, %{vehicle | streams: lines})
  end

  defp value(field, vehicle, _at), do: Object.value(field, vehicle)

  defp group(name, group, now) do
    @group_fields
    |> Object.show(Map.put(group, :age, max(now - group.at, 0) / 1_000_000))
    |> Map.put(:data, Fields.plain(name, group.data))
  end

  # The latest link first: its device or address, and its baud rate.
  defp port([id | _], links) do
    case links do
      # An open serial port; its device and rate may have been found by searching.
      %{^id => %{baud: baud, local: local}} when baud != nil -> {local, baud}
      %{^id => %{spec: %{device: device, baud: baud}}} when device != nil -> {device, baud}
      %{^id => %{url: url}} -> {text(url), nil}
      _unknown -> {Json.plain(id), nil}
    end
  end

  defp port([], _links), do: {nil, nil}

  defp age(nil, _now), do: nil
  defp age(at, now), do: Float.round(max(now - at, 0) / 1_000_000, 2)

  defp text(value) when is_binary(value), do: Json.text(value)
  defp text(_unknown), do: nil
end
