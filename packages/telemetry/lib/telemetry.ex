defmodule :telemetry do
  @moduledoc """
  Delivers events from libraries to handlers that measure them.

  A library calls `execute/3` where something happens; an application attaches functions to the names of the events. Handlers
  run in the process that executes the event; an event without handlers costs one ETS lookup.

      :telemetry.attach("count-messages", [:gnat, :message_received], &MyApp.Metrics.count/4, nil)
      :telemetry.execute([:gnat, :message_received], %{count: 1}, %{topic: "a.b"})

  A handler that raises, exits or throws is detached and reported in the log, so that a broken handler never affects the code
  that it observes. The order of the handlers of an event is undefined.
  """

  alias Telemetry.HandlerTable

  require Logger

  @type handler_id :: term()
  @type event_name :: [atom(), ...]
  @type event_measurements :: map()
  @type event_metadata :: map()
  @type handler_config :: term()
  @type handler_function :: (event_name(), event_measurements(), event_metadata(), handler_config() -> any())

  @doc """
  Attaches `function` to one event, under an id that no other handler has. Use an external capture (`&Mod.fun/4`): any other
  function is slower to call, and does not survive a code change.
  """
  @spec attach(handler_id(), event_name(), handler_function(), handler_config()) ::
          :ok | {:error, :already_exists}
  def attach(id, event_name, function, config), do: attach_many(id, [event_name], function, config)

  @doc "Attaches one handler to several events. Detaching it, or its failure on any of them, removes it from all."
  @spec attach_many(handler_id(), [event_name()], handler_function(), handler_config()) ::
          :ok | {:error, :already_exists}
  def attach_many(id, event_names, function, config) when is_list(event_names) and is_function(function, 4),
    do: HandlerTable.insert(id, Enum.uniq(event_names), function, config)

  @doc "Removes a handler from all its events."
  @spec detach(handler_id()) :: :ok | {:error, :not_found}
  def detach(id), do: HandlerTable.delete(id)

  @doc "The id and the event of each handler of events whose names begin with `prefix`; of all for `[]`."
  @spec list_handlers([atom()]) :: [%{id: handler_id(), event_name: event_name()}]
  def list_handlers(prefix), do: HandlerTable.by_prefix(prefix)

  @doc "Calls every handler of `event_name` with the name, the measurements, the metadata and its own configuration."
  @spec execute(event_name(), event_measurements(), event_metadata()) :: :ok
  def execute([_ | _] = event_name, measurements, metadata) when is_map(measurements) and is_map(metadata) do
    for {id, function, config} <- HandlerTable.for_event(event_name) do
      try do
        function.(event_name, measurements, metadata, config)
      catch
        kind, reason -> failed(id, event_name, Exception.format(kind, reason, __STACKTRACE__))
      end
    end

    :ok
  end

  defp failed(id, event_name, failure) do
    # Another process may have detached it already.
    _ = detach(id)

    Logger.error(
      "telemetry: handler #{inspect(id)} failed on #{inspect(event_name)} and is detached\n" <> failure
    )
  end
end
