defmodule MavRouter.Link.Transport.Net.Senders do
  @turn_ms 30_000
  @max 4_096

  @moduledoc """
  Since when the senders of datagrams have been heard: a bounded value that costs a look-up for each datagram.

  A sender is an address and the system id that its datagram claims, so that systems behind one router are told apart. One that is silent
  is forgotten after #{div(@turn_ms, 1000)} to #{div(2 * @turn_ms, 1000)} s. At most #{@max} are known, and newcomers get half of that: however many addresses are made
  up, who was known before stays known.
  """

  defstruct recent: %{}, former: %{}, turned: nil

  @typedoc "Monotonic ms of the first datagram, of those heard since the last turn, and of those heard in the turn before."
  @type t :: %__MODULE__{
          recent: %{sender => integer},
          former: %{sender => integer},
          turned: integer | nil
        }
  @type sender :: {address :: term, system :: byte | nil}

  @doc "None."
  @spec new() :: t
  def new, do: %__MODULE__{}

  @doc "The sender of a datagram. Nothing is checked: a made-up system id makes a new sender, which has been heard since now."
  @spec of({term, binary}) :: sender
  def of({address, <<0xFD, _::32, system, _::binary>>}), do: {address, system}
  def of({address, <<0xFE, _::16, system, _::binary>>}), do: {address, system}
  def of({address, _bytes}), do: {address, nil}

  @doc "Takes note of the senders of datagrams that were read at `now` (monotonic ms)."
  @spec note(t, [{term, binary}], integer) :: t
  def note(%__MODULE__{turned: turned} = senders, datagrams, now) do
    senders =
      if turned != nil and now - turned < @turn_ms,
        do: senders,
        else: %{senders | recent: %{}, former: senders.recent, turned: now}

    %{senders | recent: latest(datagrams, senders.recent, senders.former, now)}
  end

  defp latest([], recent, _former, _now), do: recent

  defp latest([datagram | rest], recent, former, now) do
    sender = of(datagram)

    if is_map_key(recent, sender),
      do: latest(rest, recent, former, now),
      else: latest(rest, add(recent, sender, former, now), former, now)
  end

  defp add(recent, sender, former, now) do
    case former do
      %{^sender => since} when map_size(recent) < @max -> Map.put(recent, sender, since)
      _new when map_size(recent) < div(@max, 2) -> Map.put(recent, sender, now)
      _full -> recent
    end
  end

  @doc "Since when a sender has been heard, nil for one that is not known."
  @spec since(t, sender) :: integer | nil
  def since(%__MODULE__{recent: recent, former: former}, sender), do: recent[sender] || former[sender]
end
