defmodule Aerie.Control.Policy.Compile do
  @moduledoc """
  From the section `policy` of the configuration, whose values have the right types already, to a policy. Finds everything
  that contradicts itself or names what does not exist, at once.
  """

  alias MavCodec.Meaning.{Commands, Messages}
  alias Aerie.Vehicle.Command.Types
  alias Aerie.Control.Policy
  alias Aerie.Control.Policy.Compile.Modes
  alias Aerie.Control.Policy.{Fence, Intent}
  alias Aerie.Control.Policy.Store.Settings
  alias Aerie.Control.Policy.Rules.{Condition, Window}
  alias Aerie.Base.Settings.Schema
  alias MavCodec.Dialects.All

  # Fifty a second and a hundred at once: more than any stream of set-points, less than a flood.
  @rates [%{types: :all, sources: :all, vehicles: :all, interval_us: 20_000, burst: 100}]
  @max_items 100
  # Leases and rates go by names.
  @own ~w(elixir shadow unsigned)
  # Commands of MAV_CMD that have no name in Aerie's table.
  @by_number for %{type: "mav_cmd_" <> _id = type} <- Commands.all(), do: type

  @typedoc "Where it is, what was expected there, and what was found."
  @type error :: {key :: String.t(), expected :: String.t(), got :: String.t()}

  @doc "The policy of a section. Keys that are not there, or nil, are as in an empty section."
  @spec policy(map()) :: {:ok, Policy.t()} | {:error, [error(), ...]}
  def policy(section) do
    section = Schema.complete(Enum.map(Settings.settings(), & &1.field), section)
    {fence, fence_errors} = fence(section.geofence_file)
    {modes, mode_errors} = Modes.compile(section.modes)
    {conditions, condition_errors} = list(section, :conditions, &condition/2)
    {windows, window_errors} = list(section, :windows, &window/2)
    {rates, rate_errors} = list(section, :rates, &rate/2)
    {open, open_errors} = list(section, :open, &open/2)
    {clients, client_errors} = list(section, :clients, &client/2)
    {sources, source_errors} = list(section, :sources, &source/2)

    errors = [
      altitudes(section),
      fence_errors,
      mode_errors,
      condition_errors,
      window_errors,
      rate_errors,
      open_errors,
      client_errors,
      source_errors,
      conditions_twice(conditions),
      clients_twice(clients),
      twice("policy.sources", sources, :name),
      twice("policy.sources", sources, :nkey)
    ]

    case Enum.concat(errors) do
      [] ->
        {:ok,
         %Policy{
           max_altitude: section.max_altitude,
           min_altitude: section.min_altitude,
           max_altitude_msl: section.max_altitude_msl,
           takeoff_battery: section.takeoff_battery,
           ready_battery: section.ready_battery,
           fence: fence,
           modes: modes,
           conditions: conditions |> Enum.concat() |> Enum.into(Condition.defaults()),
           windows: windows,
           rates: if(section.rates == nil, do: @rates, else: rates),
           unknown: section.unknown,
           open: open,
           clients: clients,
           sources: sources,
           unsigned: section.unsigned,
           lease: section.lease,
           audit_required: section.audit.required
         }}

      errors ->
        {:error, errors}
    end
  end

  @doc "An error as a line."
  @spec text(error()) :: String.t()
  def text({key, expected, got}), do: "#{key}: expected #{expected}, got: #{got}"

  defp altitudes(%{min_altitude: min, max_altitude: max})
       when is_number(min) and is_number(max) and min >= max,
       do: [{"policy.min_altitude", "less than max_altitude (#{max})", "#{min}"}]

  defp altitudes(_section), do: []

  defp fence(nil), do: {nil, []}

  defp fence(file) do
    case Fence.read(file) do
      {:ok, fence} -> {fence, []}
      {:error, lines} -> {nil, Enum.map(lines, &{"policy.geofence_file", "a fence", &1})}
    end
  end

  defp list(section, key, fun) do
    items = Map.fetch!(section, key) || []

    if length(items) > @max_items do
      {[], [{"policy.#{key}", "at most #{@max_items} entries", "#{length(items)}"}]}
    else
      results = for {item, n} <- Enum.with_index(items), do: fun.("policy.#{key}[#{n}]", item)
      {for({:ok, value} <- results, do: value), for({:error, errors} <- results, error <- errors, do: error)}
    end
  end

  defp condition(path, item) do
    neither =
      if item.armed == nil and item.in_air == nil, do: [{path, "armed or in_air", "neither"}], else: []

    with :ok <- ok(neither ++ types("#{path}.types", item.types, &known/2)),
         do: {:ok, for(type <- item.types, do: {type, %{armed: item.armed, in_air: item.in_air}})}
  end

  defp window(path, item) do
    from = minutes("#{path}.from", item.from)
    to = minutes("#{path}.to", item.to)

    empty =
      if is_integer(from) and from == to, do: [{"#{path}.to", "another time than from", item.to}], else: []

    wrong = for {_key, _expected, _got} = error <- [from, to], do: error
    types = if item.types, do: types("#{path}.types", item.types, &may_wait/2), else: []

    with :ok <- ok(wrong ++ empty ++ types),
         do: {:ok, %{types: item.types || :moving, days: item.days || Window.days(), from: from, to: to}}
  end

  defp may_wait(path, type) do
    if type in Intent.ending(),
      do: [{path, "commands that may wait", "#{type}, which holds a vehicle or brings it down"}],
      else: known(path, type)
  end

  defp rate(path, item) do
    missing = if item.per_minute, do: [], else: [{"#{path}.per_minute", "a number", "nothing"}]

    with :ok <- ok(types("#{path}.types", item.types || [], &may_wait/2) ++ missing) do
      {:ok,
       %{
         types: item.types || :all,
         sources: item.sources || :all,
         vehicles: item.vehicles || :all,
         interval_us: max(round(60_000_000 / item.per_minute), 1),
         burst: item.burst
       }}
    end
  end

  defp client(path, item), do: with(:ok <- ok(looks_on(path, item)), do: {:ok, item})

  # A viewer has no permission, whatever it was given (`Aerie.Control.Policy.Roles.allowed?/2`).
  defp looks_on(path, %{role: :viewer, permissions: [permission | _]}),
    do: [
      {"#{path}.permissions", "none for a viewer, which may do nothing; give the role operator",
       "#{permission}"}
    ]

  defp looks_on(_path, _item), do: []
  # A command with a row is judged by it, whatever is opened.
  defp open(path, %{command: id, message: nil}) when id != nil do
    case Commands.get(id) do
      nil ->
        {:ok, {:command, id}}

      row ->
        {:error, [{"#{path}.command", "a command that the gateway does not know", "#{id} (#{row.name})"}]}
    end
  end

  defp open(path, %{command: nil, message: id}) when id != nil do
    if Messages.row(id) == nil,
      do: {:ok, {:message, id}},
      else:
        {:error, [{"#{path}.message", "a message that the gateway does not know", "#{id} (#{All.name(id)})"}]}
  end

  defp open(path, %{command: nil}), do: {:error, [{path, "command or message", "neither"}]}
  defp open(path, _both), do: {:error, [{path, "either command or message", "both"}]}

  defp source(path, item) do
    nkey =
      case Nkey.from_public(item.nkey || "") do
        {:ok, :user, _public} -> []
        _other -> [{"#{path}.nkey", "the public nkey of a user (U…)", item.nkey || "nothing"}]
      end

    own =
      if item.name in @own,
        do: [{"#{path}.name", "a name that the gateway itself does not use", item.name}],
        else: []

    expires = expires("#{path}.expires", item.expires)
    wrong = for {_key, _expected, _got} = error <- [expires], do: error

    # Signatures name it without spaces.
    with :ok <- ok(own ++ nkey ++ looks_on(path, item) ++ wrong),
         do: {:ok, %{item | expires: expires, nkey: String.trim(item.nkey)}}
  end

  # The day is its last one.
  defp expires(_path, nil), do: nil

  defp expires(path, text) do
    case Date.from_iso8601(text) do
      {:ok, day} -> day |> Date.add(1) |> DateTime.new!(~T[00:00:00]) |> DateTime.to_unix(:microsecond)
      {:error, _reason} -> {path, "a day such as 2027-12-31", text}
    end
  end

  # A second entry would silently take the place of the first.
  defp conditions_twice(conditions) do
    types = for entry <- conditions, {type, _condition} <- entry, do: type
    for type <- repeated(types), do: {"policy.conditions", "one entry for each command", "#{type} twice"}
  end

  defp clients_twice(clients) do
    others = Enum.count(clients, &(&1.id == nil))

    catch_all =
      if others > 1,
        do: [{"policy.clients", "one entry without an id, for all others", "#{others}"}],
        else: []

    catch_all ++ twice("policy.clients", Enum.reject(clients, &(&1.id == nil)), :id)
  end

  defp twice(path, items, key),
    do:
      for(
        value <- items |> Enum.map(&Map.fetch!(&1, key)) |> repeated(),
        do: {path, "each #{key} once", "#{value} twice"}
      )

  defp repeated(values), do: Enum.uniq(values -- Enum.uniq(values))

  defp types(path, nil, _check), do: [{path, "names of commands", "nothing"}]
  defp types(path, types, check), do: Enum.flat_map(types, &check.(path, &1))

  defp known(path, type) do
    if type in Types.names() or type in Intent.raw() or type in @by_number,
      do: [],
      else: [{path, "names of commands (docs/commands.md lists them)", type <> hint(type)}]
  end

  defp hint(type) do
    case Schema.did_you_mean(type, Types.names()) do
      nil -> ""
      hint -> " (#{hint})"
    end
  end

  # HH:MM; 24:00 is the end of a day.
  defp minutes(path, text) do
    with [_all, hours, minutes] <- Regex.run(~r/\A(\d{1,2}):(\d{2})\z/, text || ""),
         at = String.to_integer(hours) * 60 + String.to_integer(minutes),
         true <- String.to_integer(minutes) < 60 and at <= 1440 do
      at
    else
      _other -> {path, "a time of day such as 06:30, UTC", text || "nothing"}
    end
  end

  defp ok([]), do: :ok
  defp ok(errors), do: {:error, errors}
end
