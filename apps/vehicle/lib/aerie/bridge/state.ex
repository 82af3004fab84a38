defmodule Aerie.Bridge.State do
  @moduledoc """
  Publishes vehicles' state: fire and forget, last value first.

  `put/5` runs in the vehicle's process: it encodes and leaves the message in a table, one place per subject, and wakes
  this process once per place. So a slow or absent NATS costs one value per subject, never a queue: the newer value
  takes the place of the older one, which is counted as superseded. When NATS is back, the last value of each subject
  is published; also one that was sent in the last #{div(30_000, 1000)} seconds, because nobody knows which of those a connection took with
  it when it broke. Older ones are left alone: another gateway may know better by now.
  """
  use GenServer

  alias Aerie.Bridge.{Connection, Message, Tables}
  alias Aerie.{Config, Fleet, Names}

  @max_subjects 100_000
  @look_again_ms 1_000
  @doubtful_ms 30_000

  @spec start_link(gateway: Names.gateway(), config: Config.t()) :: GenServer.on_start()
  def start_link(options) do
    GenServer.start_link(__MODULE__, options, name: Names.via(options[:gateway], :bridge_state))
  end

  @doc "Leaves a message to be published. Never waits for NATS."
  @spec put(Names.gateway(), String.t(), atom(), map(), integer()) :: :ok
  def put(gateway, vehicle, group, map, at) do
    with %{values: values} = tables <- Tables.get(gateway),
         {pid, {environment, epoch}} <- publisher(gateway) do
      {data, time_boot_ms} = parts(map)
      group = Atom.to_string(group)
      subject = Message.state_subject(environment, vehicle, group)
      body = Message.state(vehicle, group, data, time_boot_ms, at, epoch)

      if leave(tables, values, {subject, body, "state." <> group}) and
           :ets.insert_new(values, {{:dirty, subject}}) do
        send(pid, {:publish, subject})
      end
    end

    :ok
  rescue
    # The tables went away with a bridge that is being restarted: the next value comes soon.
    ArgumentError -> :ok
  end

  defp publisher(gateway) do
    case Registry.lookup(Aerie.Registry, {gateway, :bridge_state, nil}) do
      [{pid, {_environment, _epoch} = value}] -> {pid, value}
      _ -> nil
    end
  end

  # A group as the vehicle's snapshot has it, or just its data.
  defp parts(%{data: data} = group) when is_map(data), do: {data, Map.get(group, :time_boot_ms)}
  defp parts(data), do: {data, nil}

  defp leave(tables, values, {subject, _body, label} = message) do
    cond do
      :ets.info(values, :size) >= 2 * @max_subjects and not :ets.member(values, subject) ->
        Tables.count(tables, :state_dropped, subject: label)
        false

      # Gives false when a value waits already.
      :ets.insert_new(values, message) ->
        true

      # The older value may just have been taken: then it counts as superseded although it was published. Never the
      # other way round: the newer one is there in any case.
      true ->
        Tables.count(tables, :state_superseded, subject: label)
        :ets.insert(values, message)
    end
  end

  @impl GenServer
  def init(options) do
    gateway = options[:gateway]
    Process.set_label({:bridge_state, gateway})
    tables = Tables.get(gateway)
    Names.put_value(gateway, :bridge_state, {options[:config].environment, Fleet.Journal.epoch(gateway)})
    current = Connection.current(tables)
    conn = current && current.conn
    {:ok, sweep(%{tables: tables, conn: conn, last_conn: conn})}
  end

  @impl GenServer
  # Away: the mark stays, so that nobody wakes us for this subject again; the sweep takes it off.
  def handle_info({:publish, _subject}, %{conn: nil} = state), do: {:noreply, state}

  def handle_info({:publish, subject}, state), do: {:noreply, publish(subject, state)}

  def handle_info({:bridge, :up, conn}, %{last_conn: conn} = state),
    do: {:noreply, sweep(%{state | conn: conn})}

  def handle_info({:bridge, :up, conn}, state) do
    doubtful(state.tables)
    {:noreply, sweep(%{state | conn: conn, last_conn: conn})}
  end

  def handle_info({:bridge, :down}, state), do: {:noreply, %{state | conn: nil}}

  # A connection that did not answer, but was not lost either, sends no news.
  def handle_info(:look_again, %{conn: nil} = state) do
    current = Connection.current(state.tables)
    {:noreply, sweep(%{state | conn: current && current.conn})}
  end

  def handle_info(_message, state), do: {:noreply, state}

  defp sweep(%{conn: nil} = state), do: state

  defp sweep(state) do
    subjects = :ets.select(state.tables.values, [{{{:dirty, :"$1"}}, [], [:"$1"]}])
    Enum.reduce(subjects, state, &publish/2)
  end

  defp publish(_subject, %{conn: nil} = state), do: state

  defp publish(subject, %{tables: %{values: values} = tables, conn: conn} = state) do
    # The mark goes first: a value that comes after the take makes a new one.
    :ets.delete(values, {:dirty, subject})

    case :ets.take(values, subject) do
      [{^subject, body, label} = message] ->
        case pub(conn, subject, body) do
          :ok ->
            Tables.count(tables, :published, subject: label)

            if :ets.info(tables.sent, :size) < @max_subjects,
              do: :ets.insert(tables.sent, {subject, message, now()})

            state

          {:error, :gone} ->
            put_back(values, message)
            Tables.count(tables, :publish_errors)
            Process.send_after(self(), :look_again, @look_again_ms)
            %{state | conn: nil}

          {:error, :refused} ->
            Tables.count(tables, :publish_errors)
            state
        end

      [] ->
        state
    end
  end

  defp doubtful(%{sent: sent, values: values}) do
    for {_subject, message, at} <- :ets.tab2list(sent),
        now() - at <= @doubtful_ms,
        do: put_back(values, message)

    :ets.delete_all_objects(sent)
  end

  defp pub(conn, subject, body) do
    case Gnat.pub(conn, subject, body) do
      :ok -> :ok
      {:error, %{reason: {:payload_too_large, _size, _max}}} -> {:error, :refused}
      {:error, _reason} -> {:error, :gone}
    end
  catch
    :exit, _reason -> {:error, :gone}
  end

  # Unless a newer value is there already.
  defp put_back(values, {subject, _body, _label} = message) do
    :ets.insert_new(values, message)
    :ets.insert(values, {{:dirty, subject}})
  end

  defp now, do: System.monotonic_time(:millisecond)
end
