defmodule Telemetry.HandlerTable do
  @moduledoc """
  The ETS table of attached handlers, and the process that changes it.

  The process that executes an event reads the table directly. Attaching and detaching go through this one, one at a time, so
  that no two handlers share an id, and a handler of several events is attached and detached as a whole.
  """

  use GenServer

  require Logger

  @table :telemetry_handler_table

  @type row :: {:telemetry.handler_id(), :telemetry.handler_function(), :telemetry.handler_config()}

  @spec start_link(keyword()) :: GenServer.on_start()
  def start_link(_opts), do: GenServer.start_link(__MODULE__, nil, name: __MODULE__)

  @spec insert(
          :telemetry.handler_id(),
          [:telemetry.event_name()],
          :telemetry.handler_function(),
          :telemetry.handler_config()
        ) ::
          :ok | {:error, :already_exists}
  def insert(id, event_names, function, config) do
    GenServer.call(__MODULE__, {:insert, id, event_names, function, config})
  end

  @spec delete(:telemetry.handler_id()) :: :ok | {:error, :not_found}
  def delete(id), do: GenServer.call(__MODULE__, {:delete, id})

  @doc "The handlers of exactly this event; none, and a warning, if the application is not running."
  @spec for_event(:telemetry.event_name()) :: [row()]
  def for_event(event_name) do
    for {_event, id, function, config} <- :ets.lookup(@table, event_name), do: {id, function, config}
  rescue
    ArgumentError ->
      Logger.warning("telemetry: #{inspect(event_name)} is lost, the application :telemetry is not started")
      []
  end

  @doc "The handlers of the events whose names begin with `prefix`."
  @spec by_prefix([atom()]) :: [%{id: :telemetry.handler_id(), event_name: :telemetry.event_name()}]
  def by_prefix(prefix) do
    for {event_name, id, _, _} <- :ets.tab2list(@table),
        List.starts_with?(event_name, prefix),
        do: %{id: id, event_name: event_name}
  end

  @doc "Makes the table, which belongs to the calling process."
  @spec create() :: :ok
  def create do
    _ = :ets.new(@table, [:duplicate_bag, :public, :named_table, read_concurrency: true])
    :ok
  end

  @impl GenServer
  def init(nil), do: {:ok, nil}

  @impl GenServer
  def handle_call({:insert, id, event_names, function, config}, _from, state) do
    if rows(id) != [] do
      {:reply, {:error, :already_exists}, state}
    else
      :ets.insert(@table, for(event_name <- event_names, do: {event_name, id, function, config}))
      {:reply, :ok, state}
    end
  end

  def handle_call({:delete, id}, _from, state) do
    case rows(id) do
      [] ->
        {:reply, {:error, :not_found}, state}

      rows ->
        Enum.each(rows, &:ets.delete_object(@table, &1))
        {:reply, :ok, state}
    end
  end

  # Compared as a value, because an id such as {:"$1"} or :_ must not act as a variable of a match specification.
  defp rows(id), do: for({_event, ^id, _, _} = row <- :ets.tab2list(@table), do: row)
end
