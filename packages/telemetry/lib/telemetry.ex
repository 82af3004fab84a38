defmodule :telemetry do
  @moduledoc """
  Delivers events from libraries to handlers that measure them.

  A library calls `execute/3` where something happens; an application attaches functions to the names of the events. Handlers
  run in the process that executes the event; an event without handlers costs one ETS lookup.

      :telemetry.attach("count-messages", [:gnat, :message_received], &MyApp.Metrics.count/4, nil)
      :telemetry.execute([:gnat, :message_received], %{count: 1}, %{topic: "a.b"})

  A handler that raises, exits or throws is detached, and `[:telemetry, :handler, :failure]` is executed with

    * measurements: `monotonic_time`, `system_time` (native units)
    * metadata: `event_name`, `handler_id`, `handler_config`, `kind` (`:error`, `:exit` or `:throw`), `reason`,
      `stacktrace`

  so that a broken handler never affects the code that it observes. The order of the handlers of an event is undefined.
  """

  alias Telemetry.HandlerTable

  require Logger

  @type handler_id :: term()
  @type event_name :: [atom(), ...]
  @type event_prefix :: [atom()]
  @type event_measurements :: map()
  @type event_metadata :: map()
  @type event_value :: number()
  @type handler_config :: term()
  @type handler_function :: (event_name(), event_measurements(), event_metadata(), handler_config() -> any())
  @type handler :: %{
          id: handler_id(),
          event_name: event_name(),
          function: handler_function(),
          config: handler_config()
        }
  @type span_result :: term()
  @type span_function ::
          (-> {span_result(), event_metadata()} | {span_result(), event_measurements(), event_metadata()})

  @failure_event [:telemetry, :handler, :failure]

  @doc """
  Attaches `function` to one event, under an id that no other handler has.

  Use an external capture (`&Mod.fun/4`): any other function is slower to call, does not survive a code change, and is
  reported once, at level info. The error is `badarg` (`ArgumentError` in Elixir) if the name is not a non-empty list of atoms or the
  function does not take four arguments.
  """
  @spec attach(handler_id(), event_name(), handler_function(), handler_config()) ::
          :ok | {:error, :already_exists}
  def attach(id, event_name, function, config) do
    faults = event_fault(event_name) || function_fault(function)
    if faults, do: :erlang.error(:badarg, [id, event_name, function, config], said(faults))
    insert(id, [event_name], function, config)
  end

  @doc "Attaches one handler to several events. Detaching it, or its failure on any of them, removes it from all."
  @spec attach_many(handler_id(), [event_name()], handler_function(), handler_config()) ::
          :ok | {:error, :already_exists}
  def attach_many(id, event_names, function, config) do
    faults = events_fault(event_names) || function_fault(function)
    if faults, do: :erlang.error(:badarg, [id, event_names, function, config], said(faults))
    insert(id, event_names, function, config)
  end

  defp insert(id, event_names, function, config) do
    warn_if_local(id, function)
    HandlerTable.insert(id, Enum.uniq(event_names), function, config)
  end

  @doc "Removes a handler from all its events."
  @spec detach(handler_id()) :: :ok | {:error, :not_found}
  def detach(id), do: HandlerTable.delete(id)

  @doc "The same as `execute(event_name, measurements, %{})`."
  @spec execute(event_name(), event_measurements() | event_value()) :: :ok
  def execute(event_name, measurements), do: execute(event_name, measurements, %{})

  @doc """
  Calls every handler of `event_name` with the name, the measurements, the metadata and its own configuration.

  A bare number instead of a map of measurements is deprecated: it becomes `%{value: number}`, with a warning.
  """
  @spec execute(event_name(), event_measurements() | event_value(), event_metadata()) :: :ok
  def execute(event_name, value, metadata) when is_number(value) do
    Logger.warning("telemetry: #{inspect(event_name)} was executed with a number; give a map of measurements")
    execute(event_name, %{value: value}, metadata)
  end

  def execute([_ | _] = event_name, measurements, metadata) when is_map(measurements) and is_map(metadata) do
    run(HandlerTable.for_event(event_name), event_name, measurements, metadata)
  end

  @doc """
  Runs `function` between the events `prefix ++ [:start]` and `prefix ++ [:stop]`, or `prefix ++ [:exception]`.

  `function` returns `{result, stop_metadata}` or `{result, extra_measurements, stop_metadata}`; `result` is returned.
  An exception is re-raised after its event.

  Measurements: `:start` has `system_time` and `monotonic_time`; the other two have `duration` and `monotonic_time`,
  all in native units; extra measurements cannot replace those. Metadata: as given, plus `telemetry_span_context` (the same
  reference in both events, unless the metadata has one); `:exception` has the start's
  metadata plus `kind`, `reason` and `stacktrace`.
  """
  @spec span(event_prefix(), event_metadata(), span_function()) :: span_result()
  def span(prefix, start_metadata, function) do
    started = :erlang.monotonic_time()
    context = make_ref()

    execute(
      prefix ++ [:start],
      %{monotonic_time: started, system_time: :erlang.system_time()},
      with_context(start_metadata, context)
    )

    try do
      function.()
    catch
      kind, reason ->
        stacktrace = __STACKTRACE__
        failure = Map.merge(start_metadata, %{kind: kind, reason: reason, stacktrace: stacktrace})
        execute(prefix ++ [:exception], elapsed(started), with_context(failure, context))
        :erlang.raise(kind, reason, stacktrace)
    else
      {result, stop_metadata} ->
        execute(prefix ++ [:stop], elapsed(started), with_context(stop_metadata, context))
        result

      {result, extra, stop_metadata} ->
        measurements = Map.merge(extra, elapsed(started))
        execute(prefix ++ [:stop], measurements, with_context(stop_metadata, context))
        result
    end
  end

  @doc """
  All handlers of the events whose names begin with `prefix`, `[]` for all. A handler of several events is listed once
  for each of them.
  """
  @spec list_handlers(event_prefix()) :: [handler()]
  def list_handlers(prefix) do
    unless atoms?(prefix),
      do: :erlang.error(:badarg, [prefix], said(%{1 => "an event prefix must be a list of atoms"}))

    HandlerTable.by_prefix(prefix)
  end

  defp run([], _event_name, _measurements, _metadata), do: :ok

  defp run([{id, function, config} | rest], event_name, measurements, metadata) do
    try do
      function.(event_name, measurements, metadata, config)
    catch
      kind, reason -> failed(id, config, event_name, kind, reason, __STACKTRACE__)
    end

    run(rest, event_name, measurements, metadata)
  end

  # Detached before the event, so that a failing failure handler causes no loop.
  defp failed(id, config, event_name, kind, reason, stacktrace) do
    # Another process may have detached it already.
    _ = detach(id)

    execute(
      @failure_event,
      %{monotonic_time: :erlang.monotonic_time(), system_time: :erlang.system_time()},
      %{
        event_name: event_name,
        handler_id: id,
        handler_config: config,
        kind: kind,
        reason: reason,
        stacktrace: stacktrace
      }
    )

    Logger.error(
      "telemetry: handler #{inspect(id)} failed on #{inspect(event_name)} and is detached\n" <>
        Exception.format(kind, reason, stacktrace)
    )
  end

  defp elapsed(started) do
    now = :erlang.monotonic_time()
    %{duration: now - started, monotonic_time: now}
  end

  defp with_context(%{telemetry_span_context: _own} = metadata, _context), do: metadata
  defp with_context(metadata, context), do: Map.put(metadata, :telemetry_span_context, context)

  defp warn_if_local(id, function) do
    if Function.info(function, :type) == {:type, :local} do
      # A report, so that programs can read the handler's id.
      Logger.info(%{
        handler_id: id,
        message:
          "telemetry: this handler is a local function, which is called slower than a capture like &Mod.fun/4"
      })
    end
  end

  # What is wrong with an argument, by its number: Erlang and Elixir add it to the `badarg`.
  defp said(faults), do: [error_info: %{module: __MODULE__, cause: faults}]

  @doc false
  @spec format_error(term(), list()) :: %{pos_integer() => String.t()}
  def format_error(_reason, [{_module, _function, _arguments, info} | _]), do: info[:error_info].cause

  defp function_fault(function) when is_function(function, 4), do: nil
  defp function_fault(_other), do: %{3 => "a handler must be a function of four arguments"}

  defp events_fault(names) when is_list(names), do: Enum.find_value(names, &event_fault/1)
  defp events_fault(_other), do: %{2 => "the event names must be a list"}

  defp event_fault([]), do: %{2 => "an event name must not be empty"}

  defp event_fault(name) do
    unless atoms?(name), do: %{2 => "an event name must be a list of atoms"}
  end

  defp atoms?(list), do: is_list(list) and Enum.all?(list, &is_atom/1)
end
