defmodule Msp.Session.Asking do
  @moduledoc """
  The next request: who is there, then what clients asked for, what is due, and what takes long. Clients that ask without end do not silence the
  vehicle. One request is under way at a time.
  """

  alias Msp.{Exchange, Polls, Session}
  alias Msp.Session.{Identifying, Missions, Motors, Sticks, Tasks}

  @again_us 10_000
  # A poll is asked again soon, and its reply counts when it comes late.
  @poll_us 100_000
  @least_us 250_000

  @doc "Asks, if the line is free."
  @spec next(Session.t(), integer) :: {Session.t(), [Session.action()]}
  def next(%{phase: :identifying, identifying: %{todo: [name | more]}} = session, now) do
    case MavCodec.Msp.request(Identifying.target(session), name) do
      {:ok, frame} -> send_if_ready(session, :task, {:about, name}, frame, now, @least_us)
      # This version does not have it.
      {:error, _why} -> next(put_in(session.identifying.todo, more), now)
    end
  end

  def next(%{exchange: exchange} = session, now) do
    case exchange.asked do
      none when none == %{} -> any(session, now)
      %{state: _, task: _} -> {session, []}
      # What waits is overdue.
      %{task: _} -> poll(session, now)
      %{state: _} -> task(session, [:urgent, :program, :bulk], now)
    end
  end

  defp any(session, now) do
    if Polls.late?(session.polls, now),
      do: poll(session, now),
      else:
        session
        |> task([:urgent, :program], now)
        |> or_else(&poll(&1, now))
        |> or_else(&task(&1, [:bulk], now))
  end

  defp or_else({session, []}, ask), do: ask.(session)
  defp or_else(written, _ask), do: written

  defp task(session, kinds, now) do
    free = Exchange.free_at(session.exchange, :task, now)
    if free != nil and free <= now, do: task_of(session, kinds, now), else: {session, []}
  end

  defp task_of(session, [], _now), do: {session, []}

  defp task_of(session, [kind | kinds], now) do
    case Tasks.next(session, kind) do
      {:none, session} ->
        task_of(session, kinds, now)

      {:look, looked} ->
        # One that cannot be sent now does not count.
        with {_looked, []} <- poll(looked, Polls.status(session.polls), now), do: {session, []}

      {{:ask, task, frame, patience}, session} ->
        send_if_ready(session, :task, {:task, task}, frame, now, max(patience, @least_us))
    end
  end

  defp poll(session, now) do
    case Polls.next(session.polls, now) do
      {:ask, name, arguments} -> poll(session, {name, arguments}, now)
      _nothing_due -> {session, []}
    end
  end

  defp poll(session, {name, arguments}, now) do
    {:ok, frame} = MavCodec.Msp.request(Identifying.target(session), name, arguments)
    {session, written} = send_if_ready(session, :state, {:poll, name}, frame, now, @poll_us)

    if written == [],
      do: {session, []},
      else: {%{session | polls: Polls.asked(session.polls, name, now)}, written}
  end

  defp send_if_ready(session, lane, tag, frame, now, patience) do
    if Exchange.ready(session.exchange, lane, frame, now) == :now do
      {bytes, exchange} = Exchange.send(session.exchange, lane, tag, frame, now, patience)
      {%{session | exchange: exchange}, [{:write, bytes}]}
    else
      {session, []}
    end
  end

  @doc "When to look again."
  @spec wake(Session.t(), integer) :: integer
  def wake(session, now) do
    stops = with at when at != nil <- Motors.due_at(session), do: max(at, now + @again_us)
    Enum.min(for at <- [stops, Sticks.due_at(session), line(session, now)], at != nil, do: at)
  end

  defp line(%{exchange: exchange} = session, now) do
    case Exchange.deadline(exchange) do
      nil -> wanted(session, now)
      deadline -> min(deadline, beside(session, now) || deadline)
    end
  end

  # What the other lane may do once the reply is overdue.
  defp beside(%{phase: :up, exchange: exchange} = session, now) do
    polled = Exchange.free_at(exchange, :state, now)
    tasked = Exchange.free_at(exchange, :task, now)

    cond do
      polled != nil -> max(max(polled, now + @again_us), polled(session, now))
      tasked != nil and Tasks.any?(session) -> max(tasked, now + @again_us)
      true -> nil
    end
  end

  defp beside(_session, _now), do: nil

  defp wanted(session, now) do
    if session.phase != :up or Tasks.any?(session) or Missions.uploading?(session),
      do: now + @again_us,
      else: polled(session, now)
  end

  defp polled(session, now) do
    case Polls.next(session.polls, now) do
      {:at, at} -> at
      _due -> now + @again_us
    end
  end
end
