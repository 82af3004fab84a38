defmodule MavRouter.Link.Transport.Net.Gathering do
  @wait_ms 1

  @moduledoc """
  Whether a busy UDP server reads datagrams one by one, or gathers what comes within #{@wait_ms} ms: a value.

  With many vehicles on a port, nearly every datagram wakes the link and a session, which costs more than to read it. When more than
  2,000 reads a second bring datagrams of changing senders, the link waits after each read, and so wakes a thousand times a
  second at most. A single sender, however fast, is not delayed.
  """

  @window_ms 100
  # Reads in a window from which on gathering pays, and datagrams in a window below which it does not any more.
  @begin 200
  @go_on 100

  defstruct since: nil, reads: 0, datagrams: 0, changes: 0, last: nil, on?: false

  @typedoc "About the window that began at `since` (monotonic ms): reads, datagrams, and how often the sender changed; `last`: the last one"
  @type t :: %__MODULE__{
          since: integer | nil,
          reads: non_neg_integer,
          datagrams: non_neg_integer,
          changes: non_neg_integer,
          last: term,
          on?: boolean
        }

  @doc "Nothing was read."
  @spec new() :: t
  def new, do: %__MODULE__{}

  @doc "How long to wait for more after a read (ms); 0: not at all."
  @spec wait_ms(t) :: 0 | unquote(@wait_ms)
  def wait_ms(%{on?: true}), do: @wait_ms
  def wait_ms(_gathering), do: 0

  @doc "Datagrams were read at once, at `now` (monotonic ms)."
  @spec read(t, [{sender :: term, binary}], integer) :: t
  def read(%{since: since} = gathering, datagrams, now) when since != nil and now - since < @window_ms,
    do: note(gathering, datagrams)

  # A window that ended long ago says nothing about now.
  def read(%{since: since} = gathering, datagrams, now) do
    on? = since != nil and now - since < 2 * @window_ms and busy?(gathering)
    note(%__MODULE__{since: now, last: gathering.last, on?: on?}, datagrams)
  end

  defp busy?(%{on?: false} = gathering), do: gathering.reads >= @begin and gathering.changes >= @begin
  defp busy?(%{on?: true} = gathering), do: gathering.datagrams >= @go_on and gathering.changes >= @go_on

  defp note(gathering, datagrams) do
    note(datagrams, gathering.datagrams, gathering.changes, gathering.last, %{
      gathering
      | reads: gathering.reads + 1
    })
  end

  defp note([], n, changes, last, gathering),
    do: %{gathering | datagrams: n, changes: changes, last: last}

  defp note([{last, _bytes} | rest], n, changes, last, gathering),
    do: note(rest, n + 1, changes, last, gathering)

  defp note([{sender, _bytes} | rest], n, changes, _last, gathering),
    do: note(rest, n + 1, changes + 1, sender, gathering)
end
