defmodule Aerie.Signing.Vault do
  @moduledoc """
  Reads the keys when the gateway starts, and keeps the time stamps in a file: twice a minute and whenever a link reaches
  what it had reserved, so that no time stamp is used twice and nothing that was received is accepted again after a restart
  or `kill -9`, with or without a clock (S6).

  The file (`signing.dir/timestamps.json`, mode 0600) has no keys in it: link ids, time stamps, streams. Nothing waits for
  the disk: links reserve half a minute ahead and go on. When it cannot be written, that is told (`status/1`, telemetry
  `[:aerie, :signing, :not_stored]`) and tried again.
  """
  use GenServer

  alias Aerie.Names
  alias Aerie.Signing.{Key, Scope, State, Tables}

  require Logger

  @every_ms 25_000
  @soon_ms 50

  @doc "Options: `:gateway`, `:config`, `:dir`."
  @spec start_link(keyword) :: GenServer.on_start()
  def start_link(options) do
    GenServer.start_link(__MODULE__, options,
      name: Names.via(Keyword.fetch!(options, :gateway), :signing_vault)
    )
  end

  @doc "A link has reserved time stamps up to this one; called by the link's process, returns at once."
  @spec reserve(Names.gateway(), Tables.t(), {String.t(), Scope.id()}, non_neg_integer) :: :ok
  def reserve(gateway, tables, key, timestamp) do
    :ets.insert(tables.reserved, {key, timestamp})
    with pid when is_pid(pid) <- Names.whereis(gateway, :signing_vault), do: send(pid, :soon)
    :ok
  end

  @doc "Puts a scope in the place of the one with its id."
  @spec adopt(Names.gateway(), Scope.t()) :: :ok
  def adopt(gateway, scope), do: GenServer.call(Names.via(gateway, :signing_vault), {:adopt, scope})

  @doc "Takes a scope away that was put there by `adopt/2`."
  @spec drop(Names.gateway(), Scope.id()) :: :ok
  def drop(gateway, id), do: GenServer.call(Names.via(gateway, :signing_vault), {:drop, id})

  @doc "Reads all keys again. A key that cannot be read now does not replace one that could."
  @spec reload(Names.gateway()) :: [{Scope.id(), :same | :changed | {:error, String.t()}}]
  def reload(gateway), do: GenServer.call(Names.via(gateway, :signing_vault), :reload)

  @doc "Writes the file now."
  @spec save(Names.gateway()) :: :ok | {:error, String.t()}
  def save(gateway), do: GenServer.call(Names.via(gateway, :signing_vault), :save)

  @impl GenServer
  def init(options) do
    Process.flag(:trap_exit, true)
    gateway = Keyword.fetch!(options, :gateway)
    Process.set_label({:signing_vault, gateway})
    tables = Tables.of(gateway)
    config = Keyword.get(options, :config)
    state = %{gateway: gateway, tables: tables, config: config, dir: dir(config), saved: nil, soon: false}

    # After a crash of this process the tables are still there.
    if :ets.insert_new(tables.settings, {:read, true}), do: begin(state, Scope.all(config))
    Process.send_after(self(), :save, @every_ms)
    {:ok, state}
  end

  defp dir(%{signing: %{dir: dir}}) when is_binary(dir), do: dir
  defp dir(_none), do: "var/signing"

  defp begin(_state, []), do: :ok

  defp begin(state, scopes) do
    for %Scope{error: error} = scope when error != nil <- scopes,
        do:
          Logger.error("signing of #{Scope.name(scope.id)}: #{error}; nothing signed is accepted from there")

    case State.read(file(state)) do
      {:ok, stored} ->
        restore(state.tables, stored)

      {:error, reason} ->
        Logger.error("time stamps of signed links are lost, the clock has to do: #{reason}")
    end

    Enum.each(scopes, &Tables.put_scope(state.tables, &1))
  end

  defp restore(tables, stored) do
    for {link, number} <- stored.link_ids, do: :ets.insert(tables.settings, {{:link_id, link}, number})
    highest = stored.link_ids |> Map.values() |> Enum.max(fn -> -1 end)
    :ets.insert(tables.settings, {:next_link_id, highest})
    for {key, timestamp, streams} <- stored.entries, do: :ets.insert(tables.stored, {key, timestamp, streams})
    :ok
  end

  @impl GenServer
  def handle_call({:adopt, scope}, _from, state), do: {:reply, Tables.put_scope(state.tables, scope), state}
  def handle_call({:drop, id}, _from, state), do: {:reply, Tables.delete_scope(state.tables, id), state}

  def handle_call(:save, _from, state) do
    {result, state} = write(state)
    {:reply, result, state}
  end

  def handle_call(:reload, _from, state) do
    {:reply, Enum.map(Scope.all(state.config), &{&1.id, reload(&1, state)}), state}
  end

  defp reload(%Scope{error: error}, _state) when error != nil, do: {:error, error}

  defp reload(scope, %{tables: tables}) do
    old = :ets.lookup_element(tables.scopes, scope.id, 2, nil)

    if old != nil and Key.same?(old.secret, scope.secret) do
      :same
    else
      Tables.put_scope(tables, scope)
      :changed
    end
  end

  @impl GenServer
  def handle_info(:soon, %{soon: true} = state), do: {:noreply, state}

  def handle_info(:soon, state) do
    Process.send_after(self(), :save_now, @soon_ms)
    {:noreply, %{state | soon: true}}
  end

  def handle_info(:save_now, state) do
    {_result, state} = write(%{state | soon: false})
    {:noreply, state}
  end

  def handle_info(:save, state) do
    Process.send_after(self(), :save, @every_ms)
    {_result, state} = write(state)
    {:noreply, state}
  end

  def handle_info(_exit, state), do: {:noreply, state}

  @impl GenServer
  def terminate(_reason, state), do: write(state)

  defp write(state) do
    bytes = State.encode(state.tables)

    cond do
      bytes == nil or bytes == state.saved ->
        {:ok, state}

      true ->
        case State.write(file(state), bytes) do
          :ok -> {:ok, %{state | saved: bytes}}
          {:error, reason} -> {not_stored(state, reason), state}
        end
    end
  end

  defp not_stored(state, reason) do
    :ets.insert(state.tables.settings, {:not_stored, reason})

    :telemetry.execute([:aerie, :signing, :not_stored], %{count: 1}, %{gateway: state.gateway, reason: reason})

    {:error, reason}
  end

  defp file(state), do: Path.join(state.dir, "timestamps.json")
end
