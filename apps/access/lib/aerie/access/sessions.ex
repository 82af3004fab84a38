defmodule Aerie.Access.Sessions do
  @moduledoc """
  The sessions that are open: a cookie counts only as long as its session is in this table. Signing out ends the session wherever its cookie
  is: in other tabs, in other browsers, in somebody's notes. So does a change of the user's role, permissions or password, or the user's removal.

  A session is listed by the digest of its random id, in a file that only its owner can read, so that a restart signs nobody out and brings no
  session back. Each user has 20 at most, and so has the printed address; the oldest ends for a new one.

  The end of a session is announced as `{:notice, :console_sessions}` of `Aerie.Base.PubSub`.
  """
  use GenServer

  alias Aerie.Base.Names
  alias Aerie.Base.PubSub
  alias Aerie.Access.PrivateFile

  require Logger

  @each 20
  @max_file 1_048_576
  @look_ms 60_000

  @typedoc "Whose: a user's by name, or nil for the printed address."
  @type owner :: String.t() | nil

  @doc "Options: `:gateway`, `:file`."
  @spec start_link(keyword()) :: GenServer.on_start()
  def start_link(options),
    do: GenServer.start_link(__MODULE__, options, name: Names.via(options[:gateway], :console_sessions))

  @doc "Opens a session for so many seconds; gives its id, which only the cookie has."
  @spec open(Names.gateway(), owner(), seconds :: pos_integer()) :: String.t()
  def open(gateway, owner, seconds) do
    id = Base.url_encode64(:crypto.strong_rand_bytes(24), padding: false)
    call(gateway, {:open, digest(id), owner, System.system_time(:second) + seconds})
    id
  end

  @doc "Whether a session is open, and whose."
  @spec owner(Names.gateway(), id :: term(), now :: integer()) :: {:ok, owner()} | :error
  def owner(gateway, id, now) when is_binary(id) do
    digest = digest(id)

    Names.read(gateway, :console_sessions, :error, fn table ->
      case :ets.lookup(table, digest) do
        [{^digest, owner, until}] when until > now -> {:ok, owner}
        _none -> :error
      end
    end)
  end

  def owner(_gateway, _id, _now), do: :error

  @doc "Ends a session. It is over when this returns."
  @spec finish(Names.gateway(), id :: term()) :: :ok
  def finish(gateway, id) when is_binary(id), do: call(gateway, {:finish, digest(id)})
  def finish(_gateway, _id), do: :ok

  # Without the process nobody is signed in, and there is nothing to end.
  defp call(gateway, request) do
    GenServer.call(Names.via(gateway, :console_sessions), request)
  catch
    :exit, _gone -> :ok
  end

  defp digest(id), do: :crypto.hash(:sha256, id)

  @impl GenServer
  def init(options) do
    Process.set_label(:console_sessions)
    gateway = options[:gateway]
    :ok = PubSub.subscribe(gateway, {:notice, :console_users})
    table = :ets.new(:console_sessions, [:set, :protected, read_concurrency: true])
    true = :ets.insert(table, read(options[:file]))
    Names.put_value(gateway, :console_sessions, table)
    Process.send_after(self(), :look, @look_ms)
    {:ok, %{gateway: gateway, file: options[:file], table: table}}
  end

  @impl GenServer
  def handle_call({:open, digest, owner, until}, _from, %{table: table} = state) do
    own = for {_digest, ^owner, _until} = row <- :ets.tab2list(table), do: row

    oldest =
      own
      |> Enum.sort_by(fn {_digest, _owner, until} -> until end)
      |> Enum.take(max(length(own) - @each + 1, 0))

    true = :ets.insert(table, {digest, owner, until})
    {:reply, :ok, ended(state, oldest)}
  end

  def handle_call({:finish, digest}, _from, %{table: table} = state),
    do: {:reply, :ok, ended(state, :ets.lookup(table, digest))}

  @impl GenServer
  def handle_info({:fleet, {:notice, :console_users}, name}, %{table: table} = state),
    do: {:noreply, ended(state, for({_digest, ^name, _until} = row <- :ets.tab2list(table), do: row))}

  def handle_info(:look, %{table: table} = state) do
    now = System.system_time(:second)
    Process.send_after(self(), :look, @look_ms)

    case for({_digest, _owner, until} = row <- :ets.tab2list(table), until <= now, do: row) do
      [] -> {:noreply, state}
      over -> {:noreply, ended(state, over)}
    end
  end

  def handle_info(_stray, state), do: {:noreply, state}

  defp ended(state, rows) do
    for {digest, _owner, _until} <- rows, do: :ets.delete(state.table, digest)
    write(state)
    if rows != [], do: PubSub.publish(state.gateway, {:notice, :console_sessions}, :ended)
    state
  end

  # A change that cannot be written holds until the next start.
  defp write(%{file: file, table: table}) do
    sessions =
      for {digest, owner, until} <- :ets.tab2list(table),
          do: %{id: Base.encode64(digest), user: owner, until: until}

    with {:error, text} <- PrivateFile.write(file, [JSON.encode_to_iodata!(%{sessions: sessions}), ?\n]) do
      Logger.error(
        "#{text}. Sessions that end now would be open again after a restart; remove the file before one"
      )
    end
  end

  # Users without a readable entry sign in again.
  defp read(file) do
    with {:ok, %File.Stat{size: size}} when size <= @max_file <- File.stat(file),
         {:ok, text} <- File.read(file),
         {:ok, %{"sessions" => sessions}} when is_list(sessions) <- JSON.decode(text) do
      Enum.flat_map(sessions, &row/1)
    else
      {:error, :enoent} ->
        []

      _unreadable ->
        Logger.warning("#{file} cannot be read: everybody has to sign in again")
        []
    end
  end

  defp row(%{"id" => id, "user" => owner, "until" => until})
       when is_binary(id) and (is_binary(owner) or owner == nil) and is_integer(until) do
    case Base.decode64(id) do
      {:ok, <<_::256>> = digest} -> [{digest, owner, until}]
      _other -> []
    end
  end

  defp row(_other), do: []
end
