defmodule Aerie.Link.Transport do
  @moduledoc """
  How a link moves bytes: one module for each kind, each a value that the link's process feeds with messages.

  A connection is opened by a helper process (`open/1` may block on names, connections and devices), given to the link
  (`give/2`), and from then on lives in the link's process: `activate/1`, then `handle/2` with every message that the
  link does not know itself. No transport parses, counts or reconnects.

  ## Memory

  What is read is handed on as it came; frames are sub-binaries of it, shared by everyone, never copied. A read is at most
  64 KiB, so a frame that is kept (a queue, a cache, a map) keeps up to 64 KiB alive: whoever keeps one beyond the
  handling of its batch calls `:binary.copy/1` on what it keeps.

  ## Back-pressure

  Sockets deliver a limited number of messages (`{:active, n}`), then wait to be asked again; a link that does not keep up
  leaves the rest in the kernel. Datagrams that waited there too long are thrown away and counted (`Aerie.Link.Backlog`), as
  are those that the kernel had no room for. A write never blocks: what does not fit a bounded buffer is refused with `:busy`.
  """

  alias Aerie.Link.Spec

  @typedoc "A connection: private to its transport."
  @type conn :: term

  @typedoc "Who is at the other end: `:remote` where there is only one, else the transport's name of the peer."
  @type peer :: :remote | {:inet.ip_address(), :inet.port_number()} | pos_integer

  @typedoc """
  - `:local`: where we are, for people (`0.0.0.0:14550`)
  - `:port`: the real port of a server, also when port 0 was asked for
  - `:peer`: the other end, for people, when it is one and known
  - `:baud`: of a serial port; `:finding`: how it was found, where it was looked for
  """
  @type info :: %{
          optional(:local) => String.t(),
          optional(:port) => non_neg_integer,
          optional(:peer) => String.t(),
          optional(:baud) => pos_integer,
          optional(:finding) => Aerie.Link.Serial.Finding.t()
        }

  @typedoc """
  - `{:read, [{peer, bytes}]}`: received, in order
  - `{:records, [{at, bytes}]}`: replayed, with their recorded times (unix microseconds)
  - `{:peer_up, peer, text}`, `{:peer_down, peer, reason}`: connections of a server
  - `{:closed, reason}`: the connection is over, to be made again
  - `{:ended, text}`: there is nothing more to come, ever
  - `{:sniffed, place, baud, sniffed}`: what bytes that hold no frames are (`Aerie.Link.Serial.Sniff`)
  - `{:count, name, n}`: something to count (`Aerie.Link.Counters`)
  - `{:written, result}`: the late outcome of a write, `{:ok, bytes} | {:error, reason}`
  """
  @type event ::
          {:read, [{peer, binary}]}
          | {:records, [{integer, binary}]}
          | {:peer_up, peer, String.t()}
          | {:peer_down, peer, term}
          | {:closed, term}
          | {:ended, String.t()}
          | {:sniffed, String.t(), pos_integer, Aerie.Link.Serial.Sniff.t()}
          | {:count, atom, pos_integer}
          | {:written, {:ok, non_neg_integer} | {:error, term}}

  @doc "Whether reads are whole datagrams or pieces of a stream, and whether peers come and go unannounced."
  @callback framing() :: :datagram | :stream

  @doc "Opens; runs in a process of its own and may block. The reason is one that `Aerie.Link.Reason` has words for."
  @callback open(Spec.t()) :: {:ok, conn} | {:error, term}

  @doc "Hands the connection to the link's process; runs in the process that opened it."
  @callback give(conn, link :: pid) :: :ok | {:error, term}

  @doc "Begins to deliver messages to the calling process."
  @callback activate(conn) :: {:ok, conn, info} | {:error, term}

  @doc "Takes a message of the link's mailbox, and with it as many more of its own as make a batch."
  @callback handle(conn, message :: term) :: {[event], conn} | :unknown

  @doc "Writes to a peer without blocking."
  @callback write(conn, peer, iodata) :: {:ok, conn} | {:busy, conn} | {:error, term, conn}

  @doc "Ends a peer of a server."
  @callback drop(conn, peer) :: conn

  @doc "Closes."
  @callback close(conn) :: :ok

  @doc """
  Tells that what was delivered is dealt with, and how many messages wait at the slowest vehicle; for transports that
  read only as fast as their readers (replay).
  """
  @callback delivered(conn, backlog :: non_neg_integer) :: conn

  @doc """
  A value that changes when what a closed link waits for may be there (a device plugged in): then it is tried at once. nil
  for what cannot be watched. Looked at four times a second while the link is down.
  """
  @callback watch(Spec.t()) :: term

  @doc "Frames stay away though bytes come: asks for a `{:sniffed, place, baud, sniffed}` event."
  @callback sniff(conn) :: conn

  @doc """
  The socket and address by which any process may write to a peer without asking the link's, or nil. Only where one write
  is one datagram: writes of a stream would mix.
  """
  @callback direct(conn, peer) :: {:udp, :socket.socket(), map} | nil

  @doc "How many datagrams the kernel has dropped since the connection was opened. Asked four times a second."
  @callback kernel_dropped(conn) :: non_neg_integer

  @optional_callbacks kernel_dropped: 1, drop: 2, delivered: 2, watch: 1, sniff: 1, direct: 2

  @modules %{
    udp_server: __MODULE__.UdpServer,
    udp_client: __MODULE__.UdpClient,
    tcp_client: __MODULE__.TcpClient,
    tcp_server: __MODULE__.TcpServer,
    websocket: __MODULE__.WebSocket,
    serial: __MODULE__.Serial,
    replay: __MODULE__.Replay
  }

  @doc "The transport of a kind of link."
  @spec module(Spec.kind()) :: module
  def module(kind), do: Map.fetch!(@modules, kind)
end
