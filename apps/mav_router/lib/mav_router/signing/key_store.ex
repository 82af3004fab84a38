defmodule MavRouter.Signing.KeyStore do
  @every_ms 25_000

  @moduledoc """
  Reads the keys when the gateway starts, keeps the keys that vehicles were given
  (`MavRouter.Signing.KeyStore.KeyFiles`), and stores the time stamps in a file: every #{div(@every_ms, 1_000)} s, and
  whenever a link reaches what it had reserved. So no time stamp is used twice after a restart or `kill -9`, with or
  without a clock (S6).

  Nothing that was received is accepted again (S3). After an orderly end the file is exact. After `kill -9` it may lack the last half
  minute: then the time stamps of a stream have to be above the highest that it can have reached by now
  (`MavCodec.Signing.resumed/3`). A vehicle whose clock stood still meanwhile is refused until it hears us
  (`MavRouter.Signing.Admission.ClockRecovery`).

  The file (`signing.dir/timestamps.json`, mode 0600) has link ids, time stamps and streams, and no keys. Nothing waits for the disk:
  links reserve half a minute ahead. A file that cannot be written is reported (`MavRouter.Signing.list/1`, telemetry
  `[:aerie, :signing, :not_stored]`) and tried again.
  """
  use GenServer

  alias Aerie.Base.Files.Damaged
  alias Aerie.Base.Error
  alias Aerie.Base.Secret
  alias Aerie.Base.Names
  alias MavRouter.Signing.Key
  alias MavRouter.Signing.KeyStore.KeyFiles
  alias MavRouter.Signing.Scope
  alias MavRouter.Signing.Settings
  alias MavRouter.Signing.KeyStore.State
  alias MavRouter.Signing.Tables

  require Logger

  @soon_ms 50
  # An operator waits for the disk; a card that is being written to may take seconds.
  @call_ms 30_000

  @doc "Options: `:gateway`, `:settings` (`MavRouter.Signing.Settings`)."
  @spec start_link(keyword) :: GenServer.on_start()
  def start_link(options) do
    GenServer.start_link(__MODULE__, options, name: Names.via(Keyword.fetch!(options, :gateway), :key_store))
  end

  @doc "A link has reserved time stamps up to this one; called by the link's process, returns at once."
  @spec reserve(Names.gateway(), Tables.t(), {String.t(), Scope.id()}, non_neg_integer) :: :ok
  def reserve(gateway, tables, key, timestamp) do
    :ets.insert(tables.reserved, {key, timestamp})
    with pid when is_pid(pid) <- Names.whereis(gateway, :key_store), do: send(pid, :soon)
    :ok
  end

  @doc """
  Keeps a key that a vehicle is about to be given, on the disk first, so that it is known whatever happens. `:generate` makes one, or
  takes the one that was made before and never proven; `:previous` takes the one before the present one.
  """
  @spec stage(Names.gateway(), Scope.id(), Secret.t() | :generate | :previous) ::
          {:ok, Scope.t()} | {:error, Error.t()}
  def stage(gateway, id, key), do: call(gateway, {:stage, id, key})

  @doc "A frame was signed with a candidate's key: it is in force from now on. Returns at once."
  @spec proven(Names.gateway(), Scope.t()) :: :ok
  def proven(gateway, candidate), do: GenServer.cast(Names.via(gateway, :key_store), {:proven, candidate})

  @doc "Waits until calls of `proven/2` have taken effect."
  @spec settle(Names.gateway()) :: :ok | {:error, Error.t()}
  def settle(gateway), do: call(gateway, :settle)

  @doc "Forgets a candidate that the vehicle certainly does not have."
  @spec discard(Names.gateway(), Scope.id()) :: :ok | {:error, Error.t()}
  def discard(gateway, id), do: call(gateway, {:discard, id})

  @doc "Forgets the key that a vehicle was given; the configuration holds again."
  @spec retire(Names.gateway(), Scope.id()) :: :ok | {:error, Error.t()}
  def retire(gateway, id), do: call(gateway, {:retire, id})

  defp call(gateway, request) do
    case GenServer.call(Names.via(gateway, :key_store), request, @call_ms) do
      {:error, fault} when is_binary(fault) -> Error.new({:unavailable, fault})
      result -> result
    end
  catch
    :exit, _reason -> Error.new({:unavailable, "the key store does not answer; try again"})
  end

  @doc "Reads all keys again. A key that cannot be read now does not replace one that could."
  @spec reload(Names.gateway()) :: [{Scope.id(), :same | :changed | {:error, String.t()}}]
  def reload(gateway), do: GenServer.call(Names.via(gateway, :key_store), :reload, @call_ms)

  @doc "Writes the file now."
  @spec save(Names.gateway()) :: :ok | {:error, String.t()}
  def save(gateway), do: GenServer.call(Names.via(gateway, :key_store), :save, @call_ms)

  @impl GenServer
  def init(options) do
    Process.flag(:trap_exit, true)
    gateway = Keyword.fetch!(options, :gateway)
    Process.set_label({:key_store, gateway})
    tables = Tables.of(gateway)
    %Settings{} = settings = Keyword.fetch!(options, :settings)

    state = %{
      gateway: gateway,
      tables: tables,
      settings: settings,
      dir: settings.dir,
      saved: nil,
      soon: false
    }

    # After a crash of this process the tables are still there.
    if :ets.insert_new(tables.settings, {:read, true}), do: begin(state, Scope.all(settings, state.dir))
    Process.send_after(self(), :save, @every_ms)
    {:ok, state}
  end

  defp begin(_state, {[], [], []}), do: :ok

  defp begin(state, {configured, given, candidates}) do
    for %Scope{error: error} = scope when error != nil <- Scope.in_force(configured, given),
        do:
          Logger.error(
            "signing of #{Scope.name(scope.id)}: #{error}; frames that need a signature are refused"
          )

    warn(configured, given, state.dir)

    case State.read(file(state)) do
      {:ok, stored} ->
        restore(state.tables, stored)

      {:error, reason} ->
        Logger.error("the time stamps of signed links are lost, the clock is used instead: #{reason}")
        path = file(state)

        # Never overwritten: the clock may be behind them.
        _ =
          if Damaged.damaged?(path),
            do: Damaged.set_aside(state.gateway, path, "the clock is used for time stamps of signatures")

        :ok
    end

    Enum.each(Scope.in_force(configured, given), &Tables.put_scope(state.tables, &1))

    for %Scope{error: nil} = scope <- candidates,
        do: Tables.put_candidate(state.tables, scope.id, scope)

    :ok
  end

  defp warn(configured, given, dir) do
    for %Scope{id: id, secret: secret} <- given,
        other = Enum.find(configured, &(&1.id == id)),
        not Key.same?(secret, other.secret) do
      Logger.warning(
        "signing of #{Scope.name(id)}: the key of the configuration (#{other.source}) is not used, because the vehicle was " <>
          "given another one. Remove #{KeyFiles.path(dir, id, :current)} to use it."
      )
    end

    :ok
  end

  defp restore(tables, stored) do
    for {link, number} <- stored.link_ids, do: :ets.insert(tables.settings, {{:link_id, link}, number})
    highest = stored.link_ids |> Map.values() |> Enum.max(fn -> -1 end)
    :ets.insert(tables.settings, {:next_link_id, highest})

    for {{_link, {network, _system}} = key, timestamp, streams} <- stored.entries do
      streams =
        if stored.ended,
          do: Map.new(streams, fn {stream, {last, _ahead}} -> {stream, last} end),
          else: MavCodec.Signing.resumed(streams, timestamp, {stored.at, clock(tables)})

      :ets.insert(tables.stored, {key, timestamp, streams})
      Enum.each(streams, &newest(tables, network, &1))
    end

    :ok
  end

  defp newest(tables, network, {{link_id, system, component}, last}) do
    stream = {network, link_id, system, component}
    if last > :ets.lookup_element(tables.newest, stream, 2, 0), do: :ets.insert(tables.newest, {stream, last})
  end

  defp clock(tables), do: Tables.clock(tables).()

  @impl GenServer
  def handle_call({:stage, id, key}, _from, state) do
    with {:ok, secret} <- secret(state, id, key),
         :ok <- KeyFiles.write(state.dir, id, :next, secret) do
      scope = Scope.given(id, {:ok, secret}, scopes(state))
      Tables.put_candidate(state.tables, id, scope)
      {:reply, {:ok, scope}, state}
    else
      {:error, reason} -> {:reply, {:error, reason}, state}
    end
  end

  def handle_call(:settle, _from, state), do: {:reply, :ok, state}

  def handle_call({:discard, id}, _from, state) do
    Tables.put_candidate(state.tables, id, nil)
    {:reply, KeyFiles.remove(state.dir, id, :next), state}
  end

  def handle_call({:retire, id}, _from, state) do
    {configured, _given, _candidates} = Scope.all(state.settings, nil)

    case Enum.find(configured, &(&1.id == id)) do
      nil -> Tables.delete_scope(state.tables, id)
      scope -> Tables.put_scope(state.tables, scope)
    end

    {:reply, KeyFiles.retire(state.dir, id), state}
  end

  def handle_call(:save, _from, state) do
    {result, state} = write(state)
    {:reply, result, state}
  end

  def handle_call(:reload, _from, state) do
    {configured, given, _candidates} = Scope.all(state.settings, state.dir)
    {:reply, configured |> Scope.in_force(given) |> Enum.map(&{&1.id, reload(&1, state)}), state}
  end

  @impl GenServer
  def handle_cast({:proven, %Scope{id: id, generation: generation} = candidate}, state) do
    case Tables.candidate(state.tables, id) do
      %Scope{generation: ^generation} -> {:noreply, promote(state, candidate)}
      # One of many frames that prove it is enough.
      _done -> {:noreply, state}
    end
  end

  defp promote(state, %Scope{id: id} = candidate) do
    former = Tables.scope(state.tables, id)

    # In force even if it cannot be stored: the vehicle has this key and no other.
    case KeyFiles.promote(state.dir, id, candidate.secret, former && former.secret) do
      :ok -> :ok
      {:error, reason} -> Logger.error("signing of #{Scope.name(id)}: its key cannot be stored: #{reason}")
    end

    Tables.put_scope(state.tables, candidate)
    Tables.put_candidate(state.tables, id, nil)
    Logger.notice("signing of #{Scope.name(id)}: the vehicle signs with the key that it was given")
    state
  end

  defp secret(state, id, :generate) do
    case Tables.candidate(state.tables, id) do
      %Scope{secret: secret} when secret != nil -> {:ok, secret}
      _none -> {:ok, Key.generate()}
    end
  end

  defp secret(state, id, :previous) do
    with {:error, reason} <- KeyFiles.read(state.dir, id, :previous),
         do: Error.new({:invalid, "there is no earlier key: #{reason}"})
  end

  defp secret(_state, _id, secret), do: {:ok, secret}

  defp scopes(state), do: for({_id, scope} <- :ets.tab2list(state.tables.scopes), do: scope)

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
  def terminate(reason, state),
    do: write(%{state | saved: nil}, reason in [:normal, :shutdown] or match?({:shutdown, _why}, reason))

  defp write(state, ended \\ false) do
    found = State.collect(state.tables)

    cond do
      found == nil or found == state.saved ->
        {:ok, state}

      true ->
        case State.write(file(state), State.encode(found, clock(state.tables), ended)) do
          :ok -> {stored(state), %{state | saved: found}}
          {:error, reason} -> {not_stored(state, reason), state}
        end
    end
  end

  defp stored(state) do
    :ets.delete(state.tables.settings, :not_stored)
    :ok
  end

  defp not_stored(state, reason) do
    :ets.insert(state.tables.settings, {:not_stored, reason})

    :telemetry.execute([:aerie, :signing, :not_stored], %{count: 1}, %{gateway: state.gateway, reason: reason})

    {:error, reason}
  end

  defp file(state), do: Path.join(state.dir, "timestamps.json")
end
