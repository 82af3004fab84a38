defmodule Msp.Session.Asking do
  @moduledoc """
  The next request: who is there, then what clients asked for, what is due, and what takes long. Clients that ask without end do not silence the
  vehicle. One request is under way at a time.
  """

  alias Msp.{Exchange, Polls, Session}
  alias Msp.Session.{Identifying, Tasks}

  @again_us 10_000

  @doc "Asks, if nothing is under way and the line is free."
  @spec next(Session.t(), integer) :: {Session.t(), [Session.action()]}
  def next(%{exchange: %{asked: asked}} = session, _now) when asked != nil, do: {session, []}

  def next(%{phase: :identifying, todo: [name | more]} = session, now) do
    case MavCodec.Msp.request(Identifying.target(session), name) do
      {:ok, frame} -> send_if_ready(session, {:about, name}, frame, now, 0)
      # This version does not have it.
      {:error, _why} -> next(%{session | todo: more}, now)
    end
  end

  def next(session, now) do
    case if(Polls.late?(session.polls, now), do: {:none, session}, else: first(session)) do
      {:none, session} -> poll(session, now)
      {:look, session} -> poll(session, Polls.status(session.polls), now)
      {{:ask, task, frame, patience}, session} -> send_if_ready(session, {:task, task}, frame, now, patience)
    end
  end

  defp first(session) do
    with {:none, session} <- Tasks.next(session, :urgent), do: Tasks.next(session, :program)
  end

  defp poll(session, now) do
    case Polls.next(session.polls, now) do
      {:ask, name, arguments} ->
        poll(session, {name, arguments}, now)

      _nothing_due ->
        case Tasks.next(session, :bulk) do
          {:none, session} ->
            {session, []}

          {:look, session} ->
            poll(session, Polls.status(session.polls), now)

          {{:ask, task, frame, patience}, session} ->
            send_if_ready(session, {:task, task}, frame, now, patience)
        end
    end
  end

  defp poll(session, {name, arguments}, now) do
    {:ok, frame} = MavCodec.Msp.request(Identifying.target(session), name, arguments)
    {session, written} = send_if_ready(session, {:poll, name}, frame, now, 0)

    if written == [],
      do: {session, []},
      else: {%{session | polls: Polls.asked(session.polls, name, now)}, written}
  end

  defp send_if_ready(session, tag, frame, now, patience) do
    if Exchange.ready(session.exchange, frame, now) == :now do
      {bytes, exchange} = Exchange.send(session.exchange, tag, frame, now, patience)
      {%{session | exchange: exchange}, [{:write, bytes}]}
    else
      {session, []}
    end
  end

  @doc "When to look again."
  @spec wake(Session.t(), integer) :: integer
  def wake(%{motors: %{due: due}} = session, now),
    do: min(max(due, now + @again_us), wake(%{session | motors: nil}, now))

  def wake(%{receiver: %{due: due}} = session, now), do: min(due, wake(%{session | receiver: nil}, now))
  def wake(%{exchange: %{deadline: deadline}}, _now) when deadline != nil, do: deadline

  def wake(%{phase: :up, tasks: [], upload: nil} = session, now) do
    case Polls.next(session.polls, now) do
      {:at, at} -> at
      _due -> now + @again_us
    end
  end

  def wake(_session, now), do: now + @again_us
end
