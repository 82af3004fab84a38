defmodule MavRouter.Link.Peers.Peer do
  # A good frame this long after the first makes a peer known; forged senders mostly send one datagram.
  @known_ms 500

  @moduledoc """
  A peer of a link: its parser, and when it was heard. A server has one for each sender or connection, every other link has
  one. So the garbage of one peer never damages the frames of another.
  """

  alias MavCodec.{Frame, Parser}

  @enforce_keys [:id, :text, :parser, :since, :heard]
  defstruct [:id, :text, :parser, :since, :heard, :framed, :stats, :counted, flushed: true, known: false]

  @typedoc """
  - `text`: for people (`10.0.0.7:14551`)
  - `since`, `heard`: monotonic ms of the first and the last bytes; `framed`: of the last good frame, nil before it
  - `flushed`: whether the parser holds no bytes that only silence can decide; `:due` if one tick has found silence
  - `known`: whether it has sent good frames for at least #{@known_ms} ms
  - `stats`: those of the parser, nil if something was read since `measure/1`; `counted`: its part of the sum of all peers
    (`MavRouter.Link.Peers`), nil for none
  """
  @type t :: %__MODULE__{
          id: term,
          text: String.t(),
          parser: Parser.t(),
          since: integer,
          heard: integer,
          framed: integer | nil,
          flushed: boolean | :due,
          known: boolean,
          stats: Parser.stats() | nil,
          counted: %{atom => non_neg_integer} | nil
        }

  @doc "A peer that has sent nothing yet."
  @spec new(term, String.t(), Parser.t(), integer) :: t
  def new(id, text, parser, now), do: %__MODULE__{id: id, text: text, parser: parser, since: now, heard: now}

  @doc "Parses bytes that came at `now` (monotonic ms) and `at` (unix microseconds); frames are taken as they are."
  @spec push(t, :stream | :datagram, binary | [Frame.t()], integer, integer) :: {[Frame.t()], t}
  def push(%__MODULE__{} = peer, framing, read, now, at) do
    {frames, parser} =
      cond do
        is_list(read) -> Parser.take(peer.parser, read, at)
        framing == :stream -> Parser.push(peer.parser, read, at)
        true -> Parser.push_datagram(peer.parser, read, at)
      end

    framed = if frames == [], do: peer.framed, else: now
    {frames, %{peer | parser: parser, heard: now, framed: framed, flushed: false, stats: nil}}
  end

  @doc "Whether the parser keeps what may be the beginning of a frame."
  @spec waiting?(t) :: boolean
  def waiting?(%__MODULE__{parser: parser}), do: Parser.waiting?(parser)

  @doc "Whether its last frame made it known."
  @spec proven?(t) :: boolean
  def proven?(%__MODULE__{since: since, framed: framed}), do: framed != nil and framed - since >= @known_ms

  @doc "Takes the counts from its parser."
  @spec measure(t) :: t
  def measure(%__MODULE__{stats: nil} = peer), do: %{peer | stats: Parser.stats(peer.parser)}
  def measure(peer), do: peer

  @doc "Nothing more came for a while, or the connection ended: the parser decides about the bytes that it holds."
  @spec flush(t) :: {[Frame.t()], t}
  def flush(%__MODULE__{flushed: true} = peer), do: {[], peer}

  def flush(%__MODULE__{} = peer) do
    {frames, parser} = Parser.flush(peer.parser)
    {frames, %{peer | parser: parser, flushed: true, stats: nil}}
  end
end
