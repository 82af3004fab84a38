defmodule Aerie.Control.Params do
  @moduledoc """
  The parameters of a vehicle, for programs in Elixir:

      {:ok, table} = Aerie.Control.Params.list(gateway, "VID-001")
      {:ok, %Aerie.Vehicle.Command.Result{status: :completed}} = Aerie.Control.Params.set(gateway, "VID-001", "WPNAV_SPEED", 500)

  The options of all functions are those of `t:Aerie.Control.Transfers.option/0`. With `component: 1..255`, `list`, `get` and `set` are for a camera,
  gimbal or companion that has parameters of its own (PARAM_EXT). Their values are numbers or text (`Aerie.Vehicle.Protocol.ExtValue`):

      {:ok, %Aerie.Control.Params.Param{value: 200}} = Aerie.Control.Params.get(gateway, "VID-001", "CAM_ISO", component: 100)

  A result that is not a success gives the reason, in the terms of
  `Aerie.Vehicle.Command.Result`.
  """

  @behaviour Aerie.Control.Commands.Change

  alias Aerie.Base.Names
  alias Aerie.Control.Transfers
  alias Aerie.Control.Commands.{Change, Gateways}
  alias Aerie.Vehicle.Command.{Error, Refusal, Result}

  alias Aerie.Control.Params.{Component, Fetch, File, LongNames, Metadata, Param, Set, Table}
  alias Aerie.Control.Params.Cache.Writer, as: CacheWriter
  alias Aerie.Control.Params.Fetch.Download

  alias Aerie.Control.Policy.Intent

  @typedoc "`:component` - the component whose parameters are meant, 1 to 255; without it the autopilot's are"
  @type option :: Transfers.option() | {:component, 1..255}

  @list_ms 300_000
  @one_ms 60_000
  # One of a list, one that is set and shown.
  @each_ms 1_000
  @set_ms 5_000

  @doc """
  All parameters, read from the vehicle in the best way that it offers (P4). A list that was read earlier, even before a restart, is
  returned if the vehicle's checksum shows that it is still right. `refresh: true` reads it again. Lists of other components have no
  checksum and are read each time.
  """
  @spec list(Names.gateway(), vehicle :: String.t(), [option() | {:refresh, boolean()}]) ::
          {:ok, Table.t()} | {:error, Result.t()}
  def list(gateway, vehicle, options \\ []) do
    {refresh?, options} = Keyword.pop(options, :refresh, false)
    {component, options} = Keyword.pop(options, :component)
    asked = {"params", "list", of(component, %{})}

    case Transfers.read_remote(gateway, vehicle, asked, options) do
      :here when component == nil -> list_of_autopilot(gateway, vehicle, refresh?, options)
      :here -> list_of_component(gateway, vehicle, component, options)
      {:ok, answer} -> remote_answer(Table.parse(answer))
      error -> error
    end
  end

  @doc "The names of the list that was last read of the autopilot of a snapshot, before a restart too; asks no vehicle."
  @spec names(Names.gateway(), map()) :: [String.t()]
  def names(gateway, snapshot) do
    case CacheWriter.stored(gateway, snapshot) do
      nil -> []
      table -> LongNames.shown(table, snapshot.autopilot).params |> Map.keys() |> Enum.sort()
    end
  end

  # The request to the gateway that hears the vehicle.
  defp of(nil, body), do: body
  defp of(component, body), do: Map.put(body, "component", component)

  defp remote_answer({:ok, value}), do: {:ok, value}

  defp remote_answer(:error), do: Transfers.error(Refusal.ended(:no_parameter))

  defp list_of_component(gateway, vehicle, component, options) do
    with {:ok, snapshot} <- Transfers.vehicle(gateway, vehicle),
         :ok <- readable(Component.check(component)) do
      transfer = %{
        lanes: [:params],
        timeout_ms: @list_ms,
        share: {:params_of, component},
        start: fn context, until ->
          target = Component.target(context, component)
          {:ok, Download.new(target, until, growing(context) ++ Component.options(context, component))}
        end
      }

      {result, nil} = Transfers.read(gateway, snapshot, transfer, options)
      result
    end
  end

  defp list_of_autopilot(gateway, vehicle, refresh?, options) do
    with {:ok, snapshot} <- Transfers.vehicle(gateway, vehicle) do
      file? = Fetch.file?(snapshot)
      stored = if not refresh?, do: CacheWriter.stored(gateway, snapshot)

      transfer = %{
        lanes: if(file?, do: [:params, :file], else: [:params]),
        timeout_ms: @list_ms,
        share: {:params, refresh?},
        start: fn context, until ->
          traits = context.protocol.traits()

          more = [
            hash: traits.param_hash?,
            begins_us: traits.param_list_s * 1_000_000,
            file: file? and context.ftp?,
            stored: stored,
            us: context.us,
            seq: context.seq
          ]

          {:ok, Fetch.new(context.target, until, more ++ growing(context) ++ common(context))}
        end
      }

      {result, nil} = Transfers.read(gateway, snapshot, transfer, options)
      kept(result, stored, gateway, snapshot)
    end
  end

  # A list that cannot be checked later is not stored.
  defp kept({:ok, table}, stored, gateway, snapshot) do
    if table != stored and (table.hash || table.file_crc), do: CacheWriter.keep(gateway, snapshot, table)
    {:ok, LongNames.shown(table, snapshot.autopilot)}
  end

  defp kept(error, _stored, _gateway, _snapshot), do: error

  @doc """
  What the vehicle says about its parameters, by name: units, ranges, descriptions, values to choose from. Only newer firmware offers it (PX4 does); of
  Betaflight and iNav the gateway knows it; of the others the result is `:failed`.
  """
  @spec metadata(Names.gateway(), vehicle :: String.t(), [Transfers.option()]) ::
          {:ok, %{String.t() => Metadata.t()}} | {:error, Result.t()}
  def metadata(gateway, vehicle, options \\ []) do
    with {:ok, snapshot} <- Transfers.vehicle(gateway, vehicle),
         nil <- LongNames.metadata(snapshot),
         do: Metadata.Reader.read(gateway, vehicle, options)
  end

  @doc "One parameter, read from the vehicle. Neither firmware answers if it does not have the parameter (`:timeout`)."
  @spec get(Names.gateway(), vehicle :: String.t(), name :: String.t(), [option()]) ::
          {:ok, Param.t()} | {:error, Result.t()}
  def get(gateway, vehicle, name, options \\ []) do
    {component, options} = Keyword.pop(options, :component)

    with :ok <- readable(check_name(name)),
         :ok <- readable(Component.check(component)),
         asked = {"params", "get", of(component, %{"name" => name})},
         :here <- Transfers.read_remote(gateway, vehicle, asked, options),
         {:ok, snapshot} <- Transfers.vehicle(gateway, vehicle) do
      transfer = %{
        lanes: [:params],
        timeout_ms: @one_ms,
        share: {:param, component, name},
        start: fn context, until ->
          target = Component.target(context, component)
          {:ok, Set.read(LongNames.wire(name), target, until, Component.options(context, component))}
        end
      }

      {result, nil} = Transfers.read(gateway, snapshot, transfer, options)
      with {:ok, param} <- result, do: {:ok, LongNames.shown(param, snapshot.autopilot)}
    else
      {:ok, answer} -> remote_answer(Param.parse(answer))
      error -> error
    end
  end

  @doc """
  Sets a parameter: `:completed` if the vehicle reported the new value (P3), `:rejected` if it keeps another one. Needs the
  permission `maintain`, and `protection` for what protects the vehicle (`Aerie.Control.Policy.Intent.Protection`). Option `:type`: its MAV_PARAM_TYPE, if known; otherwise the parameter is read first.
  Option `:was`: the value that the source saw before, for the list of commands and the audit log.

  A component that says that it works on it (PARAM_ACK_IN_PROGRESS) is waited for, up to `:timeout_ms`. `:failed` if it says so, or if it accepted the
  value and does not have it.
  """
  @spec set(Names.gateway(), vehicle :: String.t(), name :: String.t(), number() | String.t(), [
          option() | {:type, 1..11} | {:was, String.t()}
        ]) :: Transfers.answer()
  def set(gateway, vehicle, name, value, options \\ []) do
    {type, options} = Keyword.pop(options, :type)
    {component, options} = Keyword.pop(options, :component)
    {was, options} = Keyword.pop(options, :was)

    with :ok <- check(name, value, component),
         :ok <- if(component, do: :ok, else: known(gateway, vehicle, [name])) do
      remarks =
        for {key, value} <- [component: component, was: was], value != nil, into: %{}, do: {key, value}

      Transfers.change(
        gateway,
        vehicle,
        %Change{
          module: __MODULE__,
          what: {:set, name, value, type, component},
          facts: component_facts(gateway, vehicle, component, {name, value}),
          params: Map.merge(%{name: name, value: value}, remarks),
          limit_ms: @one_ms,
          sets: if(component, do: [], else: [{name, value}]),
          remote_request: {"params", "set", of(component, %{"name" => name, "value" => value})}
        },
        options
      )
    end
  end

  @doc """
  Sets several parameters one by one, from a file (`Aerie.Control.Params.File.parse/1`) or `%{name => value}`. The reason lists those that the vehicle
  refused (name and value of at most twenty); the others are set nevertheless, and the result is `:failed`.
  """
  @spec set_all(
          Names.gateway(),
          vehicle :: String.t(),
          [File.entry()] | %{String.t() => number()},
          [Transfers.option()]
        ) :: Transfers.answer()
  def set_all(gateway, vehicle, values, options \\ []),
    do: set_all(gateway, vehicle, values, Component.none!(options), [])

  defp set_all(gateway, vehicle, values, options, remarks) do
    entries = for entry <- values, do: entry(entry)

    names = for {name, _value, _type} <- entries, do: name

    with :ok <- check_all(entries), :ok <- known(gateway, vehicle, names) do
      sets = for {name, value, _type} <- entries, do: {name, value}

      Transfers.change(
        gateway,
        vehicle,
        %Change{
          module: __MODULE__,
          what: {:set_all, entries, remarks},
          facts: Intent.set_parameters(sets),
          params: %{count: length(entries), digest: digest(entries)},
          limit_ms: Transfers.time_ms(length(entries), @set_ms),
          sets: sets
        },
        options
      )
    end
  end

  @impl Change
  def review(_what, _gateway, _snapshot, _policy, _context), do: :allow

  @impl Change
  def transfer({:set, name, value, type, component}, _gateway, _snapshot) do
    {:ok,
     %{
       lanes: [:params],
       timeout_ms: @one_ms,
       start: &Component.set(LongNames.wire(name), value, type, &1, &2, component),
       details: &%{"name" => name, "value" => &1.value}
     }}
  end

  def transfer({:set_all, entries, remarks}, _gateway, _snapshot) do
    wired = for {name, value, type} <- entries, do: {LongNames.wire(name), value, type}

    {:ok,
     %{
       lanes: [:params],
       timeout_ms: Transfers.time_ms(length(wired), @set_ms),
       start: fn context, until -> {:ok, Set.All.new(wired, context.target, until, common(context))} end,
       details: &%{"set" => &1},
       complete: &Result.remark(&1, remarks)
     }}
  end

  @doc """
  Sets the parameters of a file that differ from the vehicle's, which are read first. Parameters that the vehicle does not have are refused before
  anything is set, unless `unknown: :skip` is given.
  """
  @spec load(Names.gateway(), vehicle :: String.t(), text :: binary(), [
          Transfers.option() | {:unknown, :refuse | :skip}
        ]) :: Transfers.answer() | {:error, Result.t()}
  def load(gateway, vehicle, text, options \\ []) do
    {unknown, options} = options |> Component.none!() |> Keyword.pop(:unknown, :refuse)

    with {:ok, entries, remarks} <- read_file(text, Gateways.vehicle(gateway, vehicle)),
         {:ok, table} <- list(gateway, vehicle, Keyword.take(options, [:progress])),
         {differ, missing} = differing(entries, table),
         :ok <- if(unknown == :skip, do: :ok, else: in_table(missing, table)) do
      set_all(gateway, vehicle, differ, options, remarks)
    end
  end

  @doc "The entries of a file that differ from a list, with the types of that, and the names that the list lacks."
  @spec differing([File.entry()], Table.t()) :: {[File.entry()], missing :: [String.t()]}
  def differing(entries, table) do
    {known, missing} = Enum.split_with(entries, &is_map_key(table.params, &1.name))

    differing =
      for entry <- known,
          param = table.params[entry.name],
          not File.says?(entry, param.value),
          do: %{entry | type: param.type}

    {differing, Enum.map(missing, & &1.name)}
  end

  @doc "Whether an entry of a file says the value of a parameter."
  @spec says?(File.entry(), Param.t()) :: boolean()
  def says?(entry, param), do: File.says?(entry, param.value)

  @doc "Whether two values are the same for a vehicle, which has floats of 32 bits."
  @spec same?(number() | nil, number() | nil) :: boolean()
  defdelegate same?(one, other), to: Param

  @doc "Whether a parameter differs from its default; nil if the vehicle does not tell it."
  @spec changed?(Param.t()) :: boolean() | nil
  def changed?(%{default: nil}), do: nil
  def changed?(%{value: value, default: default}), do: not Param.same?(value, default)

  @doc """
  The parameters as a file: `:param` for Mission Planner and MAVProxy, `:params` for QGroundControl, `:txt` for the command lines and configurators of
  Betaflight and iNav, of which it has to be.
  """
  @spec save(Names.gateway(), vehicle :: String.t(), :param | :params | :txt, [Transfers.option()]) ::
          {:ok, String.t()} | {:error, Result.t()}
  def save(gateway, vehicle, format, options \\ []) do
    with {:ok, snapshot} <- Transfers.vehicle(gateway, vehicle),
         {:ok, format} <- format(format, snapshot),
         {:ok, table} <- list(gateway, vehicle, Component.none!(options)),
         do: {:ok, text(table, format, snapshot)}
  end

  @doc "A list that was read as a file; `snapshot` is nil for a vehicle that is gone."
  @spec text(Table.t(), :param | :params | {:txt, term()}, map() | nil) :: String.t()
  def text(table, format, snapshot) do
    vehicle = snapshot || %{system_id: 1, component: 1}
    File.format(table, format, {vehicle.system_id, vehicle.component || 1})
  end

  @doc "Cancels a read."
  @spec cancel(Names.gateway(), vehicle :: String.t(), id :: String.t()) :: :ok | {:error, String.t()}
  defdelegate cancel(gateway, vehicle, id), to: Transfers

  defp format(:txt, snapshot) do
    release = LongNames.release(snapshot)

    if File.prints?(release),
      do: {:ok, {:txt, release}},
      else: Transfers.error(Refusal.ended(:no_command_line))
  end

  defp format(format, _snapshot), do: {:ok, format}

  @doc "The parameters of a file, or errors with their lines."
  @spec parse(binary()) :: {:ok, [File.entry()]} | {:error, [Error.t(), ...]}
  def parse(text), do: with({:error, errors} <- File.parse(text), do: wrong(errors))

  @doc "The parameters of a file for the autopilot of a snapshot, nil for any vehicle, with remarks (`Aerie.Control.Params.File.read/2`)."
  @spec read_file(binary(), map() | nil) ::
          {:ok, [File.entry()], remarks :: [String.t()]} | {:error, [Error.t(), ...]}
  def read_file(text, snapshot) do
    owner = if snapshot, do: {snapshot.system_id, snapshot.component || 1}, else: {nil, 1}
    with {:error, errors} <- File.read(text, owner, LongNames.release(snapshot)), do: wrong(errors)
  end

  defp wrong(errors) do
    {:error,
     for({line, reason} <- errors, do: Error.new(if(line, do: "line #{line}", else: "file"), reason, :rule))}
  end

  defp growing(context), do: [each_us: if(context.grows?, do: @each_ms * 1000, else: 0)]
  defp common(context), do: Component.options(context, nil)

  defp component_facts(_gateway, _vehicle, nil, set), do: Intent.set_parameters([set])

  defp component_facts(gateway, vehicle, component, set) do
    autopilot =
      case Transfers.vehicle(gateway, vehicle) do
        {:ok, snapshot} -> snapshot.component || :unknown
        {:error, _refused} -> :unknown
      end

    Intent.set_extended([set], component, autopilot)
  end

  defp entry(%{name: name, value: value, type: type}), do: {name, value, type}
  defp entry({name, value}), do: {name, value, nil}

  defp digest(entries),
    do: :crypto.hash(:sha256, :erlang.term_to_binary(Enum.sort(entries))) |> Base.encode16(case: :lower)

  defp check_all(entries) do
    if length(entries) > Table.max(),
      do: {:error, [Error.new("values", "at most #{Table.max()}", length(entries))]},
      else:
        Enum.find_value(entries, :ok, fn {name, value, _type} -> with :ok <- check(name, value), do: nil end)
  end

  defp check(name, value, component \\ nil) do
    with :ok <- check_name(name),
         :ok <- Component.check(component),
         do: if(component, do: Component.check_value(value), else: check_number(value))
  end

  defp check_name(name) do
    if LongNames.name?(name),
      do: :ok,
      else: {:error, [Error.new("name", "1 to 16 printable characters (Betaflight and iNav: to 64)", name)]}
  end

  defp check_number(value) do
    cond do
      not is_number(value) ->
        {:error, [Error.new("value", "a number", value)]}

      abs(value) > 3.4028235e38 ->
        {:error, [Error.new("value", "a number that a 32-bit float can have", value)]}

      true ->
        :ok
    end
  end

  # A read gives a result, whatever is wrong.
  defp readable(checked) do
    with {:error, [error]} <- checked, do: Transfers.error({:rejected, Exception.message(error)})
  end

  # Neither firmware answers for a parameter that it does not have. A name that is not in a list that was read before is looked
  # up in the list as it is now: a parameter may have been added since.
  defp known(gateway, vehicle, names) do
    with {:ok, %{component: component} = snapshot} when component != nil <-
           Transfers.vehicle(gateway, vehicle),
         %Table{} = stored <- CacheWriter.stored(gateway, snapshot),
         {:error, _unknown} <- in_table(names, stored),
         {:ok, table} <- list(gateway, vehicle) do
      in_table(names, table)
    else
      _not_known_or_all_in_it -> :ok
    end
  end

  defp in_table(names, table) do
    case Enum.reject(names, &is_map_key(table.params, &1)) do
      [] ->
        :ok

      missing ->
        {:error,
         for(name <- Enum.take(missing, 20), do: Error.new(name, "a parameter of this vehicle", :unknown))}
    end
  end
end
