defmodule Aerie.Link.Peer do
  @moduledoc """
  One end that a link hears: its parser and when it was heard. A server has one for each sender or connection, every
  other link just one, so that no peer's garbage touches another's frames.
  """

  alias MavCodec.Parser

  @enforce_keys [:id, :text, :parser, :since, :heard]
  defstruct [:id, :text, :parser, :since, :heard, :framed, :stats, :counted, flushed: true, known: false]

  # Who says a second good frame so long after the first is somebody; made-up senders mostly say one.
  @known_ms 500

  @typedoc """
  - `text`: for people (`10.0.0.7:14551`)
  - `since`, `heard`: monotonic ms of the first and the last bytes; `framed`: of the last good frame, nil before it
  - `flushed`: whether the parser holds nothing that only silence can decide
  - `known`: it has said good frames for at least #{500} ms
  - `stats`: the parser's, nil when something was read since they were last looked at (`measure/1`); `counted`: what the
    sum of all peers (`Aerie.Link.Peers`) has of it, nil for nothing
  """
  @type t :: %__MODULE__{
          id: term,
          text: String.t(),
          parser: Parser.t(),
          since: integer,
          heard: integer,
          framed: integer | nil,
          flushed: boolean,
          known: boolean,
          stats: Parser.stats() | nil,
          counted: %{atom => non_neg_integer} | nil
        }

  @doc "A peer that has said nothing yet."
  @spec new(term, String.t(), Parser.t(), integer) :: t
  def new(id, text, parser, now), do: %__MODULE__{id: id, text: text, parser: parser, since: now, heard: now}

  @doc "What was read of it at `now` (monotonic ms) and `at` (unix microseconds)."
  @spec push(t, :stream | :datagram, binary, integer, integer) :: {[MavCodec.Frame.t()], t}
  def push(%__MODULE__{} = peer, framing, bytes, now, at) do
    {frames, parser} =
      case framing do
        :stream -> Parser.push(peer.parser, bytes, at)
        :datagram -> Parser.push_datagram(peer.parser, bytes, at)
      end

    framed = if frames == [], do: peer.framed, else: now
    {frames, %{peer | parser: parser, heard: now, framed: framed, flushed: false, stats: nil}}
  end

  @doc "Whether it has become known by what it said last."
  @spec proven?(t) :: boolean
  def proven?(%__MODULE__{since: since, framed: framed}), do: framed != nil and framed - since >= @known_ms

  @doc "Fills in what its parser counted."
  @spec measure(t) :: t
  def measure(%__MODULE__{stats: nil} = peer), do: %{peer | stats: Parser.stats(peer.parser)}
  def measure(peer), do: peer

  @doc "Nothing more came for a while, or ever: what only waited for more is decided."
  @spec flush(t) :: {[MavCodec.Frame.t()], t}
  def flush(%__MODULE__{flushed: true} = peer), do: {[], peer}

  def flush(%__MODULE__{} = peer) do
    {frames, parser} = Parser.flush(peer.parser)
    {frames, %{peer | parser: parser, flushed: true, stats: nil}}
  end
end
