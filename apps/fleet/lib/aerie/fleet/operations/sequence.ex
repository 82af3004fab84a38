defmodule Aerie.Fleet.Operations.Sequence do
  @moduledoc """
  What each vehicle of an operation does by itself: a list of steps, done one after the other. Pure.

      [{"vehicle": "sim-001", "steps": [{"type": "arm"}, {"type": "takeoff", "params": {"altitude": 20}},
                                        {"wait": "above", "m": 5, "timeout_s": 60}]}, …]

  A step is a command, a change of the desired state (`{"shadow": {"desired": {…}}}`), or a wait. A vehicle has its
  end when its last step has, so a wait at the end holds back the next vehicle:

  | wait | until |
  |---|---|
  | `above` | it is more than `m` metres above home |
  | `at` | it is within 1 m of `m` metres above home |
  | `near` | it is within `m` metres of `lat`, `lon` over the ground, and slower than 1 m/s |
  | `landed` | it is on the ground, or the vehicle `of` is |
  | `alone` | no other vehicle of the operation stands armed on the ground; waited for before each `arm` anyway |
  | `time` | `timeout_s` have passed |

  A wait for a height or a place to which the vehicle's own steps before it do not bring it is refused, and so are
  vehicles that wait for each other's landing. A wait fails after `timeout_s`, unless it has `go_on`; `near` also fails
  when the vehicle's mode is changed meanwhile, because a pilot may have taken over. The first step that fails ends a
  vehicle; its `else` is done then.
  """

  import Aerie.Base.Json.Schema

  alias Aerie.Base.Geo.Earth
  alias Aerie.Base.Json.Schema
  alias Aerie.Fleet.Shadow.Update
  alias Aerie.Vehicle.{Command, Firmware, Snapshot}
  alias Aerie.Vehicle.Command.Error

  @waits [:above, :at, :near, :landed, :alone, :time]
  @heights [:above, :at]
  @measured [:near | @heights]
  @max_steps 8
  @max_s 3_600
  @min_m 0.1
  @max_m 10_000
  # So near to a height it is there.
  @level_m 1
  @max_errors 8
  @lifting ~w(arm takeoff)
  @levels ~w(takeoff set_altitude)
  # What moves a vehicle and does not let it land.
  @flying ~w(arm takeoff set_altitude set_yaw set_speed goto orbit hold mission_pause)
  # A vehicle that was not lifted disarms by itself after some seconds.
  @alone {:wait, %{for: :alone, m: nil, place: nil, of: nil, timeout_ms: 60_000, go_on?: false}}

  @type wait :: %{
          for: :above | :at | :near | :landed | :alone | :time,
          m: number() | nil,
          place: {lat :: number(), lon :: number()} | nil,
          of: String.t() | nil,
          timeout_ms: pos_integer(),
          go_on?: boolean()
        }
  @type step :: {:command, String.t(), map()} | {:shadow, map()} | {:wait, wait()}

  @typedoc "`:anyway?`: it takes off although it is not ready."
  @type vehicle :: %{vehicle: String.t(), steps: [step(), ...], else: [step()], anyway?: boolean()}

  @doc "Reads the vehicles of a sequence at `now` (unix microseconds); errors have the keys below `sequence`."
  @spec parse(term(), max :: pos_integer(), now :: integer()) ::
          {:ok, [vehicle(), ...]} | {:error, [Error.t(), ...]}
  def parse([_ | _] = list, max, now) when length(list) <= max do
    read =
      list
      |> Stream.with_index()
      |> Enum.reduce_while({[], []}, fn {given, i}, {vehicles, errors} ->
        case vehicle(given, "sequence[#{i}]", now) do
          {:ok, vehicle} ->
            {:cont, {[vehicle | vehicles], errors}}

          {:error, more} when length(errors) + length(more) < @max_errors ->
            {:cont, {vehicles, errors ++ more}}

          {:error, more} ->
            {:halt, {vehicles, Enum.take(errors ++ more, @max_errors)}}
        end
      end)

    case read do
      {vehicles, []} -> {:ok, Enum.reverse(vehicles)}
      {_vehicles, errors} -> {:error, errors}
    end
  end

  def parse(other, max, _now), do: {:error, [Error.new("sequence", "a list of 1 to #{max} vehicles", other)]}

  defp vehicle(%{"vehicle" => id} = given, key, now) do
    checks = [
      closed(given, ~w(vehicle steps else anyway), key),
      if(is_binary(id) and Command.token?(id), do: [], else: [Error.new(key <> ".vehicle", "an id", id)]),
      if(is_boolean(Map.get(given, "anyway", false)),
        do: [],
        else: [Error.new(key <> ".anyway", "true or false", given["anyway"])]
      )
    ]

    {steps, wrong} = steps(given["steps"], key <> ".steps", 1, now)
    {otherwise, wrong_else} = steps(Map.get(given, "else", []), key <> ".else", 0, now)

    case Enum.concat(checks) ++ wrong ++ wrong_else do
      [] -> {:ok, %{vehicle: id, steps: steps, else: otherwise, anyway?: given["anyway"] == true}}
      errors -> {:error, errors}
    end
  end

  defp vehicle(other, key, _now),
    do: {:error, [Error.new(key, "an object with a vehicle and its steps", other)]}

  defp steps(list, key, min, now) when is_list(list) and length(list) in min..@max_steps//1 do
    list
    |> Enum.with_index()
    |> Enum.reduce({[], []}, fn {given, i}, {steps, errors} ->
      case step(given, "#{key}[#{i}]", now) do
        {:ok, step} -> {steps ++ [step], errors}
        {:error, more} -> {steps, errors ++ more}
      end
    end)
  end

  defp steps(other, key, min, _now),
    do: {[], [Error.new(key, "a list of #{min} to #{@max_steps} steps", other)]}

  @doc """
  The waits for a height or a place that the vehicle's own steps before them do not reach, where nothing else moves it,
  and those for the landing of a vehicle that waits itself. No part of `parse/3`, because a schema cannot say it.
  """
  @spec futile([vehicle()]) :: [Error.t()]
  def futile(vehicles) do
    vehicles
    |> Stream.with_index()
    |> Stream.flat_map(fn {%{vehicle: id} = vehicle, i} ->
      futile(vehicle.steps, id, "sequence[#{i}].steps") ++ futile(vehicle.else, id, "sequence[#{i}].else")
    end)
    |> Stream.concat(deadlocks(vehicles))
    |> Enum.take(@max_errors)
  end

  defp futile(steps, id, key) do
    {errors, _there} =
      steps
      |> Enum.with_index()
      |> Enum.flat_map_reduce(%{m: nil, place: nil}, fn {step, i}, there ->
        {List.wrap(misses(step, there, id, "#{key}[#{i}].m")), there(step, there)}
      end)

    errors
  end

  defp misses({:wait, %{for: :above, m: m}}, %{m: height}, id, key) when height != nil do
    most = surely_above_m(height)

    if m > most,
      do: Error.new(key, "at most #{most} m: #{id} is not surely higher on its way to #{height} m", m)
  end

  defp misses({:wait, %{for: :at, m: m}}, %{m: height}, id, key)
       when height != nil and abs(m - height) > @level_m,
       do: Error.new(key, "the height of #{id} by then, #{height} m", m)

  defp misses({:wait, %{for: :near, m: m, place: {lat, lon}}}, %{place: {to_lat, to_lon}}, id, key) do
    metres = Earth.distance(Earth.point(lat, lon), Earth.point(to_lat, to_lon))
    if metres > m, do: Error.new(key, "more than the #{round(metres)} m from there to where #{id} goes", m)
  end

  defp misses(_step, _there, _id, _key), do: nil

  # The height and the place to which the steps have brought it; nil where they do not say it.
  defp there({:wait, _wait}, there), do: there
  defp there({:command, type, params}, there) when type in @levels, do: %{there | m: height(params)}

  defp there({:command, "goto", %{"lat" => lat, "lon" => lon} = params}, _there),
    do: %{m: height(params), place: {lat, lon}}

  defp there({:command, type, _params}, there),
    do: if(Command.type(type).moves_vehicle?, do: %{m: nil, place: nil}, else: there)

  defp there({:shadow, _update}, _there), do: %{m: nil, place: nil}

  defp height(%{"altitude" => to} = params) when is_number(to),
    do: if(Map.get(params, "altitude_reference", "home") == "home", do: to)

  defp height(_params), do: nil

  # Vehicles that wait for each other's landing before they do anything that may end in their own.
  defp deadlocks(vehicles) do
    waits =
      for {%{vehicle: id, steps: steps}, i} <- Enum.with_index(vehicles),
          own = steps |> Enum.with_index() |> Enum.take_while(fn {step, _j} -> not landing?(step) end),
          [_ | _] = others <- [
            for({{:wait, %{of: of}}, j} when of != nil <- own, do: {of, "sequence[#{i}].steps[#{j}].of"})
          ],
          do: {id, others}

    waiting = stuck(waits, MapSet.new(waits, &elem(&1, 0)))

    for {id, others} <- waits,
        id in waiting,
        {other, key} <- others,
        other in waiting,
        do: Error.new(key, "a vehicle that lands without waiting for #{id}", other)
  end

  defp landing?({:command, type, _params}), do: Command.type(type).moves_vehicle? and type not in @flying
  defp landing?({:shadow, _update}), do: true
  defp landing?({:wait, _wait}), do: false

  # A vehicle that waits for none that waits comes free, again and again. Usually it waits for the one before or after.
  defp stuck(waits, waiting) do
    left =
      Enum.reduce(waits, waiting, fn {id, others}, waiting ->
        if Enum.any?(others, fn {other, _key} -> other in waiting end),
          do: waiting,
          else: MapSet.delete(waiting, id)
      end)

    if left == waiting, do: left, else: stuck(Enum.reverse(waits), left)
  end

  @doc "Reads one command, or one change of the desired state, whose keys stand below `key`."
  @spec step(term(), key :: String.t(), now :: integer()) :: {:ok, step()} | {:error, [Error.t(), ...]}
  def step(%{"type" => _type, "params" => params}, key, _now) when params != nil and not is_map(params),
    do: {:error, [Error.new(key <> ".params", "an object", params)]}

  # As a command for a vehicle that any name may be; each is parsed again with its own.
  def step(%{"type" => type} = command, key, _now) do
    params = Map.get(command, "params") || %{}

    with [] <- closed(command, ~w(type params), key),
         {:ok, _command} <- Command.new(vehicle: "V", type: type, params: params) do
      {:ok, {:command, type, params}}
    else
      {:error, errors} -> {:error, below(key, errors)}
      errors -> {:error, errors}
    end
  end

  def step(%{"shadow" => shadow} = given, key, now) when map_size(given) == 1,
    do: shadow(shadow, key <> ".shadow", now)

  def step(%{"wait" => name} = given, key, _now) do
    wait = Enum.find(@waits, &(Atom.to_string(&1) == name))
    {m, timeout, go_on} = {given["m"], Map.get(given, "timeout_s", 60), Map.get(given, "go_on", false)}
    {of, lat, lon} = {given["of"], given["lat"], given["lon"]}
    m? = if wait in @measured, do: is_number(m) and m >= @min_m and m <= @max_m, else: m == nil
    near? = wait == :near
    degrees? = &if near?, do: is_number(&1) and abs(&1) <= &2, else: &1 == nil

    wrong =
      for {false, name, expected, got} <- [
            {wait != nil, "wait", "one of #{Enum.join(@waits, ", ")}", name},
            {wait == nil or m?, "m",
             "a number from #{@min_m} to #{@max_m} (m), for #{Enum.join(@measured, " and ")} only", m},
            {wait == nil or degrees?.(lat, 90), "lat", "a latitude from -90 to 90, for near only", lat},
            {wait == nil or degrees?.(lon, 180), "lon", "a longitude from -180 to 180, for near only", lon},
            {is_number(timeout) and timeout >= 1 and timeout <= @max_s, "timeout_s",
             "a number from 1 to #{@max_s}", timeout},
            {is_boolean(go_on), "go_on", "true or false", go_on},
            {of == nil or (wait == :landed and is_binary(of) and Command.token?(of)), "of",
             "an id, for landed only", of}
          ],
          do: Error.new("#{key}.#{name}", expected, got)

    case closed(given, ~w(wait m lat lon of timeout_s go_on), key) ++ wrong do
      [] ->
        place = if near?, do: {lat, lon}
        wait = %{for: wait, m: m, place: place, of: of, timeout_ms: round(timeout * 1000), go_on?: go_on}
        {:ok, {:wait, %{wait | go_on?: go_on or wait.for == :time}}}

      errors ->
        {:error, errors}
    end
  end

  def step(other, key, _now),
    do: {:error, [Error.new(key, "an object with a type, a shadow or a wait", other)]}

  @doc "Reads a change of the desired state."
  @spec shadow(term(), key :: String.t(), now :: integer()) :: {:ok, step()} | {:error, [Error.t(), ...]}
  def shadow(%{"version" => _one}, key, _now),
    do: {:error, [Error.new(key <> ".version", "no version: each vehicle has another", :rule)]}

  def shadow(shadow, key, now) do
    case Update.parse(shadow, now) do
      {:ok, _update} -> {:ok, {:shadow, shadow}}
      {:error, errors} -> {:error, below(key, errors)}
    end
  end

  defp below(key, errors), do: for(error <- errors, do: %{error | key: key <> "." <> error.key})

  defp closed(given, keys, key) do
    for name <- Enum.take(Map.keys(given) -- keys, @max_errors),
        do: Error.new("#{key}.#{Error.key(name)}", "only #{Enum.join(keys, ", ")}", :unknown)
  end

  @doc "How high a vehicle surely gets that goes to a height: firmwares are content within a metre, or a tenth of it."
  @spec surely_above_m(number()) :: number()
  def surely_above_m(height), do: Float.round(height - min(@level_m / 1, 0.1 * height), 1)

  @doc "A vehicle so many metres from a height is there."
  @spec level_m() :: number()
  def level_m, do: @level_m

  @doc "Whether a vehicle arms or takes off by its steps."
  @spec lifts?(vehicle()) :: boolean()
  def lifts?(%{steps: steps}),
    do: Enum.any?(steps, &match?({:command, type, _params} when type in @lifting, &1))

  @doc "Steps as they are done: whatever they say, of vehicles that stand on the ground one is armed at a time."
  @spec guarded([step()]) :: [step()]
  def guarded(steps),
    do: Enum.flat_map(steps, &if(match?({:command, "arm", _params}, &1), do: [@alone, &1], else: [&1]))

  @doc "A step in a word: the type of a command, `wait_above`, `wait_turn` for another vehicle's landing, or `shadow`."
  @spec word(step()) :: String.t()
  def word({:command, type, _params}), do: type
  def word({:shadow, _update}), do: "shadow"
  def word({:wait, %{of: other}}) when other != nil, do: "wait_turn"
  def word({:wait, %{for: wait}}), do: "wait_#{wait}"

  @doc """
  A vehicle of a take-off: into a mode in which it can be armed, arm, take off to `height`, and `above_m` metres up
  before the next one begins.
  """
  @spec take_off(snapshot :: map(), height :: number(), above_m :: number(), anyway? :: boolean()) :: map()
  def take_off(%{id: id} = snapshot, height, above_m, anyway? \\ false) do
    first = Firmware.arm_first(snapshot, Snapshot.data(snapshot, :mode)[:mode])
    mode = if first, do: [%{"type" => "set_mode", "params" => %{"mode" => first}}], else: []
    up = %{"type" => "takeoff", "params" => %{"altitude" => height}}
    # Firmwares take off by more than a metre a second.
    gate = %{"wait" => "above", "m" => above_m, "timeout_s" => 60 + above_m}
    vehicle = %{"vehicle" => id, "steps" => mode ++ [%{"type" => "arm"}, up, gate]}
    if anyway?, do: Map.put(vehicle, "anyway", true), else: vehicle
  end

  @doc "The JSON Schema of a sequence of at most `max` vehicles."
  @spec schema(max :: pos_integer()) :: Schema.t()
  def schema(max) do
    steps = %{type: :array, maxItems: @max_steps, items: ref("step_of_operation")}

    vehicle = %{
      vehicle: token(),
      steps: described(Map.put(steps, :minItems, 1), "what it does, one after the other"),
      else: described(steps, "what it does when one of them has failed"),
      anyway: described(%{type: :boolean}, "it takes off although it is not ready")
    }

    %{type: :array, minItems: 1, maxItems: max, items: object(vehicle, [:vehicle, :steps])}
  end

  @doc "The JSON Schema of a step."
  @spec step_schema() :: Schema.t()
  def step_schema do
    wait = fn waits, more, required ->
      properties = %{wait: %{enum: waits}, timeout_s: number(1, @max_s), go_on: %{type: :boolean}}
      object(Map.merge(properties, more), [:wait | required])
    end

    metres = number(@min_m, @max_m)

    %{
      oneOf: [
        ref("command_of_operation"),
        object(%{shadow: ref("change_of_operation")}, [:shadow]),
        wait.(@heights, %{m: metres}, [:m]),
        wait.([:near], %{m: metres, lat: number(-90, 90), lon: number(-180, 180)}, [:m, :lat, :lon]),
        wait.([:landed], %{of: token()}, []),
        wait.(@waits -- [:landed | @measured], %{}, [])
      ]
    }
  end
end
