defmodule Aerie.Control.Policy.Intent.Context do
  @moduledoc """
  What the rules know: who commands, the time, and the vehicle as it is just now. nil is "not known" everywhere.
  """

  alias Aerie.Base.Names
  alias Aerie.Control.Policy.{ControlLease, Roles}
  alias Aerie.Control.Policy.ControlLease.Holders
  alias Aerie.Vehicle.Command.Refusal
  alias Aerie.Vehicle.Firmware
  alias Aerie.Vehicle.Firmware.Modes
  alias Aerie.Vehicle.Snapshot

  defstruct [:source, :now, :lease, :position, :home, :origin, :armed, :in_air, :mode, :battery, :autopilot] ++
              [:vehicle_type, datums: [], params: %{}, standard_modes: %{}, mode_names: %{}]

  # A position that is older than this counts as unknown: the vehicle has moved since.
  @fresh_us 10_000_000
  # How far home moves by itself at take-off, and a barometer drifts on the ground.
  @home_m 1.0
  @ground_m 5.0

  @typedoc """
    * `:source` - who commands, nil for nobody that is known
    * `:now` - unix microseconds; `:lease` - who is in charge of the vehicle, nil for nobody
    * `:position` - degrees, metres above home (`alt_rel`) and above mean sea level (`alt_msl`), where its nose points,
      and when that was heard
    * `:home` - degrees and metres above mean sea level; `:origin` - the same of its local coordinates
    * `:datums` - where it took off, in metres above mean sea level: its home then, and the ground, as far as home is
      another height now
    * `:params` - values of parameters that rules depend on (`Aerie.Vehicle.Services.Switches`), by their names
    * `:mode` - its name; `:battery` - the share of its charge that is left, 0..1
    * `:autopilot`, `:vehicle_type` - the firmware and the kind of vehicle, as its snapshot has them
    * `:standard_modes` - the firmware's names for MAVLink's standard modes, as far as they are known
    * `:mode_names` - names of modes that the vehicle itself has told
  """
  @type t :: %__MODULE__{
          source: Roles.source() | nil,
          now: integer(),
          lease: ControlLease.t() | nil,
          position:
            %{
              lat: number(),
              lon: number(),
              alt_rel: number() | nil,
              alt_msl: number() | nil,
              heading: number() | nil,
              at: integer() | nil
            }
            | nil,
          home: %{lat: number(), lon: number(), alt_msl: number() | nil} | nil,
          origin: %{lat: number(), lon: number(), alt_msl: number() | nil} | nil,
          datums: [number()],
          params: %{String.t() => number()},
          armed: boolean() | nil,
          in_air: boolean() | nil,
          mode: String.t() | nil,
          battery: number() | nil,
          autopilot: Firmware.name() | nil,
          vehicle_type: String.t() | nil,
          standard_modes: %{String.t() => String.t()},
          mode_names: %{non_neg_integer() => String.t()}
        }

  @doc """
  A context of a vehicle's snapshot (`Aerie.Vehicle.Session.Core.snapshot/1`), or of the same groups without their
  times, as `aerie policy try --vehicle` has them.
  """
  @spec new(map(), Roles.source() | nil, now :: integer()) :: t()
  def new(groups, source, now) do
    {position, at} = group(groups, :position)
    {home, _at} = group(groups, :home)
    {mode, _at} = group(groups, :mode)
    {battery, _at} = group(groups, :battery)

    %__MODULE__{
      source: source,
      now: now,
      position: if(place?(position), do: Map.put(height(position), :at, at)),
      home: if(place?(home), do: %{lat: home.lat, lon: home.lon, alt_msl: home[:alt_msl]}),
      armed: mode[:armed],
      in_air: mode[:in_air],
      mode: mode[:mode],
      battery: battery[:remaining]
    }
  end

  @doc "A context of a vehicle in the gateway's store, nil for one that is not known there."
  @spec of(Names.gateway(), map() | nil, Roles.source() | nil, now :: integer()) :: t()
  def of(_gateway, nil, source, now),
    do: %{new(%{}, source, now) | autopilot: :generic, vehicle_type: "unknown"}

  def of(gateway, snapshot, source, now),
    do: seen(snapshot, Holders.of(gateway, snapshot.key), source, now)

  @doc "A context of a vehicle's snapshot and of who is in charge of it."
  @spec seen(map(), ControlLease.t() | nil, Roles.source() | nil, now :: integer()) :: t()
  def seen(snapshot, lease, source, now) do
    memory = snapshot.memory
    context = new(snapshot.groups, source, now)

    struct!(context, %{
      origin: memory[:origin] || get_in(memory, [:liftoff, :home]),
      datums: datums(context.home, memory[:liftoff]),
      params: snapshot.params,
      autopilot: snapshot.autopilot,
      vehicle_type: snapshot.vehicle_type,
      standard_modes: standard_modes(snapshot),
      mode_names: memory[:mode_names] || %{},
      lease: lease
    })
  end

  defp datums(_home, nil), do: []

  defp datums(nil, %{home: then, ground: ground}),
    do: for(msl <- [then && then.alt_msl, ground], msl != nil, do: msl)

  defp datums(home, %{home: then, ground: ground}) do
    then = then && then.alt_msl

    for {msl, from, metres} <- [{then, home.alt_msl, @home_m}, {ground, then || home.alt_msl, @ground_m}],
        msl != nil,
        from == nil or abs(msl - from) > metres,
        do: msl
  end

  defp standard_modes(snapshot) do
    memory = Map.merge(%{mode_names: %{}, standard_modes: %{}}, snapshot.memory)
    Modes.standard(Map.merge(memory, %{autopilot: snapshot.autopilot, kind: snapshot.vehicle_type}))
  end

  defp group(groups, name) do
    case groups do
      %{^name => %{data: data, at: at}} -> {data, at}
      %{^name => data} -> {data, nil}
      _unheard -> {%{}, nil}
    end
  end

  defp place?(group), do: is_number(group[:lat]) and is_number(group[:lon])

  defp height(group) do
    Map.merge(
      %{alt_rel: nil, alt_msl: nil, heading: nil},
      Map.take(group, [:lat, :lon, :alt_rel, :alt_msl, :heading])
    )
  end

  # The parts that a description of a vehicle in JSON may have: the groups of a snapshot with the fields that rules ask
  # for.
  @plain %{
    "position" => %{
      "lat" => :lat,
      "lon" => :lon,
      "alt_rel" => :alt_rel,
      "alt_msl" => :alt_msl,
      "heading" => :heading
    },
    "home" => %{"lat" => :lat, "lon" => :lon, "alt_msl" => :alt_msl},
    "mode" => %{"mode" => :mode, "armed" => :armed, "in_air" => :in_air},
    "battery" => %{"remaining" => :remaining}
  }
  @group %{"position" => :position, "home" => :home, "mode" => :mode, "battery" => :battery}
  @top ~w(position home mode battery autopilot vehicle_type at)

  @doc """
  A context from JSON: the groups `position`, `home`, `mode` and `battery` as `GET /api/vehicles/ID` has them, of which
  everything may be missing; `autopilot` and `vehicle_type`; and `at`, the time of the decision (now if left out).
  """
  @spec parse(term(), Roles.source() | nil, now :: integer()) :: {:ok, t()} | {:error, [String.t(), ...]}
  def parse(json, source, now) when is_map(json) do
    groups = for {name, keys} <- @plain, is_map_key(json, name), do: {name, group_of(name, json[name], keys)}

    errors =
      for(key <- Map.keys(json), key not in @top, do: "#{key}: expected one of #{Enum.join(@top, ", ")}") ++
        for({_name, {:error, errors}} <- groups, error <- errors, do: error) ++
        for({:error, error} <- [at(json["at"], now), autopilot(json["autopilot"])], do: error)

    with [] <- errors do
      {:ok, now} = at(json["at"], now)
      {:ok, autopilot} = autopilot(json["autopilot"])
      context = new(Map.new(groups, fn {name, {:ok, group}} -> {@group[name], group} end), source, now)
      {:ok, described(context, autopilot, json["vehicle_type"])}
    else
      errors -> {:error, errors}
    end
  end

  def parse(_other, _source, _now), do: {:error, ["expected an object with position, home, mode and battery"]}

  defp described(context, autopilot, kind) do
    context = %{context | autopilot: autopilot, vehicle_type: kind}

    if autopilot != nil and is_binary(kind),
      do: %{context | standard_modes: standard_modes(%Snapshot{autopilot: autopilot, vehicle_type: kind})},
      else: context
  end

  defp group_of(name, %{} = group, keys) do
    case for(key <- Map.keys(group), not is_map_key(keys, key), do: key) do
      [] ->
        values(name, group, keys)

      unknown ->
        {:error,
         for(key <- unknown, do: "#{name}.#{key}: expected one of #{Enum.join(Map.keys(keys), ", ")}")}
    end
  end

  defp group_of(name, _other, _keys), do: {:error, ["#{name}: expected an object"]}

  defp values(name, group, keys) do
    case for({key, value} <- group, not value?(key, value), do: "#{name}.#{key}: expected #{kind(key)}") do
      [] -> {:ok, Map.new(group, fn {key, value} -> {keys[key], value} end)}
      errors -> {:error, errors}
    end
  end

  defp value?(_key, nil), do: true
  defp value?("mode", value), do: is_binary(value)
  defp value?(key, value) when key in ["armed", "in_air"], do: is_boolean(value)
  defp value?(_key, value), do: is_number(value)

  defp kind("mode"), do: "a text"
  defp kind(key) when key in ["armed", "in_air"], do: "true or false"
  defp kind(_key), do: "a number"

  defp at(nil, now), do: {:ok, now}

  defp at(text, _now) do
    with true <- is_binary(text), {:ok, time, _offset} <- DateTime.from_iso8601(text) do
      {:ok, DateTime.to_unix(time, :microsecond)}
    else
      _other -> {:error, "at: expected a time such as 2026-11-22T10:00:00Z"}
    end
  end

  defp autopilot(nil), do: {:ok, nil}

  defp autopilot(name) do
    known = Firmware.by_text()

    with :error <- Map.fetch(known, name),
         do: {:error, "autopilot: expected one of #{known |> Map.keys() |> Enum.join(", ")}"}
  end

  @doc "The vehicle's position, or why there is none that counts."
  @spec position(t()) :: {:ok, map()} | {:unknown, String.t()}
  def position(%{position: nil}), do: {:unknown, Refusal.text(:position)}
  def position(%{position: %{at: nil} = position}), do: {:ok, position}

  def position(%{position: %{at: at} = position, now: now}) do
    if now - at <= @fresh_us,
      do: {:ok, position},
      else: {:unknown, Refusal.text(:position_old, seconds: div(now - at, 1_000_000))}
  end
end
