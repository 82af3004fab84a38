defmodule Gnat.Session do
  @moduledoc """
  The state and decisions of a connection, without the connection: subscriptions, waiting requests, liveness.

  `handle/2` takes an event and returns the new session and actions for the connection's process:

    * `{:write, iodata}` to the server
    * `{:send, to, message}` to a process or an alias
    * `{:monitor, pid}`, `{:demonitor, pid}`
    * `{:server_error, text}` for telemetry
    * `{:reply, from, term}` to a caller
    * `{:stop, error}`: this connection is over
  """

  alias Gnat.{Command, Error}

  # The subscription for all answers to requests.
  @inbox_sid 0

  @enforce_keys [:info, :inbox]
  defstruct [
    :info,
    :inbox,
    next_sid: 1,
    subs: %{},
    requests: %{},
    owned: %{},
    pongs: :queue.new(),
    heard: true
  ]

  @typep request :: %{to: reference(), pid: pid()}

  @type t :: %__MODULE__{
          info: Gnat.server_info(),
          inbox: String.t(),
          next_sid: pos_integer(),
          subs: %{pos_integer() => pid()},
          requests: %{String.t() => request()},
          owned: %{pid() => MapSet.t()},
          pongs: :queue.queue(),
          heard: boolean()
        }

  @type action ::
          {:write, iodata()}
          | {:send, pid() | reference(), term()}
          | {:monitor | :demonitor, pid()}
          | {:server_error, String.t()}
          | {:reply, GenServer.from(), term()}
          | {:stop, Error.t()}

  @type event ::
          {:message, Gnat.Parsec.message()}
          | {:sub, GenServer.from(), pid(), String.t(), String.t() | nil}
          | {:unsub, non_neg_integer()}
          | {:forget, inbox :: String.t()}
          | {:flush, GenServer.from()}
          | {:down, pid()}
          | :heard
          | :tick

  @doc "A session on a connection whose INFO was `info`; the write subscribes the inbox that answers come to."
  @spec new(Gnat.server_info()) :: {t(), [action()]}
  def new(info) do
    inbox = "_INBOX." <> unique() <> "."
    {:ok, command} = Command.sub(inbox <> "*", @inbox_sid, nil)
    {%__MODULE__{info: info, inbox: inbox, pongs: :queue.new()}, [{:write, command}]}
  end

  @spec info(t()) :: Gnat.server_info()
  def info(session), do: session.info

  @doc "The number of subscriptions, the inbox included."
  @spec subscriptions(t()) :: pos_integer()
  def subscriptions(session), do: map_size(session.subs) + 1

  @doc "Whether the server takes a message of this size."
  @spec check_size(t(), non_neg_integer()) :: :ok | {:error, Error.t()}
  def check_size(%{info: %{max_payload: max}}, size) when size > max do
    {:error, Error.new({:payload_too_large, size, max})}
  end

  def check_size(_session, _size), do: :ok

  @doc """
  A new inbox for the answer to one request. The first is sent to the alias `to` as `{to, message}`, unless
  `{:forget, inbox}` or the end of `pid` comes before.
  """
  @spec request(t(), reference(), pid()) :: {t(), inbox :: String.t(), [action()]}
  def request(session, to, pid) do
    inbox = session.inbox <> unique()
    requests = Map.put(session.requests, inbox, %{to: to, pid: pid})
    {session, actions} = own(%{session | requests: requests}, pid, inbox)
    {session, inbox, actions}
  end

  @doc "Handles an event: returns the new session and actions."
  @spec handle(t(), event()) :: {t(), [action()]}
  def handle(session, {:message, message}), do: message(session, message)

  def handle(session, {:sub, from, pid, subject, queue_group}) do
    sid = session.next_sid

    case Command.sub(subject, sid, queue_group) do
      {:ok, command} ->
        subs = Map.put(session.subs, sid, pid)
        {session, actions} = own(%{session | subs: subs, next_sid: sid + 1}, pid, sid)
        {session, actions ++ [{:write, command}, {:reply, from, {:ok, sid}}]}

      {:error, _} = error ->
        {session, [{:reply, from, error}]}
    end
  end

  def handle(session, {:forget, inbox}), do: end_request(session, inbox)

  def handle(session, {:unsub, sid}) do
    case Map.pop(session.subs, sid) do
      {nil, _subs} ->
        {session, []}

      {pid, subs} ->
        {session, actions} = disown(%{session | subs: subs}, pid, sid)
        {session, [{:write, Command.unsub(sid)} | actions]}
    end
  end

  def handle(session, {:flush, from}) do
    {%{session | pongs: :queue.in(from, session.pongs)}, [{:write, Command.ping()}]}
  end

  # A process has ended, and with it its subscriptions and requests.
  def handle(session, {:down, pid}) do
    {mine, owned} = Map.pop(session.owned, pid, MapSet.new())
    {sids, inboxes} = mine |> MapSet.to_list() |> Enum.split_with(&is_integer/1)
    session = %{session | owned: owned, subs: Map.drop(session.subs, sids)}
    writes = for sid <- sids, do: {:write, Command.unsub(sid)}
    {%{session | requests: Map.drop(session.requests, inboxes)}, writes}
  end

  def handle(session, :heard), do: {%{session | heard: true}, []}

  # A server is dead if it owes a PONG and has sent nothing since the last tick; a slow connection is not.
  def handle(session, :tick) do
    cond do
      session.heard and :queue.is_empty(session.pongs) ->
        {%{session | heard: false, pongs: :queue.in(:tick, session.pongs)}, [{:write, Command.ping()}]}

      session.heard ->
        {%{session | heard: false}, []}

      true ->
        {session, [{:stop, Error.new(:unresponsive)}]}
    end
  end

  defp message(session, {:msg, topic, @inbox_sid, reply_to, body}) do
    answer(session, topic, %{topic: topic, body: body, reply_to: reply_to, gnat: self()})
  end

  defp message(session, {:msg, topic, sid, reply_to, body}) do
    deliver(session, sid, %{topic: topic, body: body, reply_to: reply_to, sid: sid, gnat: self()})
  end

  defp message(session, {:hmsg, topic, sid, reply_to, headers, body}) do
    message =
      Map.merge(headers, %{topic: topic, body: body, reply_to: reply_to, gnat: self()})

    if sid == @inbox_sid do
      answer(session, topic, message)
    else
      deliver(session, sid, Map.put(message, :sid, sid))
    end
  end

  defp message(session, :ping), do: {session, [{:write, Command.pong()}]}
  defp message(session, {:info, info}), do: {%{session | info: Map.merge(session.info, info)}, []}
  defp message(session, {:error, text}), do: {session, [{:server_error, text}]}
  defp message(session, :ok), do: {session, []}

  defp message(session, :pong) do
    case :queue.out(session.pongs) do
      {{:value, :tick}, pongs} -> {%{session | pongs: pongs}, []}
      {{:value, from}, pongs} -> {%{session | pongs: pongs}, [{:reply, from, :ok}]}
      {:empty, _pongs} -> {session, []}
    end
  end

  # A message may still be on its way when UNSUB is sent: not an error.
  defp deliver(session, sid, message) do
    case session.subs do
      %{^sid => pid} -> {session, [{:send, pid, {:msg, message}}]}
      _ended -> {session, []}
    end
  end

  defp answer(session, inbox, message) do
    case session.requests do
      %{^inbox => %{to: to}} ->
        {session, ended} = end_request(session, inbox)
        {session, [{:send, to, {to, message}} | ended]}

      _late ->
        {session, []}
    end
  end

  defp end_request(session, inbox) do
    case Map.pop(session.requests, inbox) do
      {nil, _requests} -> {session, []}
      {%{pid: pid}, requests} -> disown(%{session | requests: requests}, pid, inbox)
    end
  end

  # One monitor for each process, however much it owns.
  defp own(session, pid, thing) do
    case session.owned do
      %{^pid => things} -> {%{session | owned: %{session.owned | pid => MapSet.put(things, thing)}}, []}
      owned -> {%{session | owned: Map.put(owned, pid, MapSet.new([thing]))}, [{:monitor, pid}]}
    end
  end

  defp disown(session, pid, thing) do
    things = MapSet.delete(Map.get(session.owned, pid, MapSet.new()), thing)

    if MapSet.size(things) == 0 do
      {%{session | owned: Map.delete(session.owned, pid)}, [{:demonitor, pid}]}
    else
      {%{session | owned: Map.put(session.owned, pid, things)}, []}
    end
  end

  defp unique, do: 12 |> :crypto.strong_rand_bytes() |> Base.url_encode64()
end
