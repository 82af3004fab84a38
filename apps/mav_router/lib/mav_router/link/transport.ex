defmodule MavRouter.Link.Transport do
  @moduledoc """
  A kind of link: how it moves bytes, and everything that others ask about it. To add one, write its module and add it to
  the list in this file.

  `c:traits/0`, `c:forms/0`, `c:parse/2` and the optional `c:option/3`, `c:place/1` and `c:explain/2` describe it: from
  them comes `MavRouter.Link.Spec`, which carries the traits to everybody who needs one.

  The other callbacks are the connection, a value that the link's process feeds with messages. A process of its own opens
  it (`c:open/1` may block on names, connections and devices) and gives it to the link (`c:give/2`). From then on it lives in
  the link's process: `c:activate/1`, then `c:handle/2` with every message that the link itself does not know. No transport
  parses frames, counts or reconnects.

  ## Memory

  Reads are passed on as they came; frames are sub-binaries of them, shared by everyone and never copied. A read has at most
  64 KiB, so a frame in a queue, a cache or a map keeps up to 64 KiB alive: call `:binary.copy/1` to keep one
  longer than its batch is handled.

  ## Back-pressure

  Sockets deliver a limited number of messages (`{:active, n}`), then wait to be asked again; a link that does not keep up
  leaves the rest in the kernel. If too many wait there, some are discarded and counted
  (`MavRouter.Link.Transport.Net.Backlog`), as are those for which the kernel had no room. A write never blocks: what
  does not fit into a bounded buffer is refused with `:busy`.
  """

  alias MavRouter.Link.Spec
  alias MavRouter.Link.Transport.Form

  @transports [
    __MODULE__.UdpServer,
    __MODULE__.UdpClient,
    __MODULE__.TcpClient,
    __MODULE__.TcpServer,
    __MODULE__.WebSocket,
    __MODULE__.Serial,
    __MODULE__.Msp,
    __MODULE__.Replay
  ]

  @typedoc """
  - `kind`: its name in snapshots
  - `framing`: whether reads are whole datagrams, whose senders come and go unannounced, or pieces of a stream
  - `protocol`: of the port that it uses, nil if there is none
  - `server`: it listens; each sender or connection is a peer of its own
  - `recorded`: its frames are from a file: read-only, with times of their own
  - `announced`: the other end learns of us only by what we send. Our heartbeat goes out while nothing is heard, and after
    a long silence the link is opened again
  - `sniffed`: bytes without frames are examined (`c:sniff/1`)
  - `client`: who may add a client endpoint of this kind: everybody who may use the API (`:remote`), only this machine and its
    configuration (`:local`, as it names a device or a file), or nobody (nil)
  """
  @type traits :: %{
          required(:kind) => atom,
          required(:framing) => :datagram | :stream,
          optional(:protocol) => :udp | :tcp,
          optional(:server) => boolean,
          optional(:recorded) => boolean,
          optional(:announced) => boolean,
          optional(:sniffed) => boolean,
          optional(:client) => :remote | :local | nil
        }

  @typedoc "A connection: private to its transport."
  @type conn :: term

  @typedoc "Who is at the other end: `:remote` where there is only one, else the transport's name of the peer."
  @type peer :: :remote | {:inet.ip_address(), :inet.port_number()} | pos_integer

  @typedoc """
  - `:local`: our end, for people (`0.0.0.0:14550`)
  - `:port`: the real port of a server, also if port 0 was configured
  - `:peer`: the other end, for people, if there is only one and it is known
  - `:warning`: what is worse than it should be, for the log
  - `:baud`: of a serial port; `:finding`: how it was found, if it was searched for
  """
  @type info :: %{
          optional(:local) => String.t(),
          optional(:port) => non_neg_integer,
          optional(:peer) => String.t(),
          optional(:warning) => String.t() | nil,
          optional(:baud) => pos_integer,
          optional(:finding) => MavRouter.Link.Serial.Finding.t()
        }

  @typedoc """
  - `{:read, [{peer, read}]}`: received, in order: bytes, or a list of frames if the transport makes them
  - `{:records, [{at, bytes}]}`: replayed, with their recorded times (unix microseconds)
  - `{:peer_up, peer, text}`, `{:peer_down, peer, reason}`: connections of a server
  - `{:refused, n, text}`: connections of a server that were beyond its limits
  - `:redirected`: writes to the other end go to another address from now on
  - `:passed_on`: asks for word when the reads before it have been delivered (`c:passed_on/2`)
  - `{:closed, reason}`: the connection ended, and is to be made again
  - `{:ended, text}`: nothing more will ever come
  - `{:warning, text}`: for the log
  - `{:sniffed, place, baud, sniffed}`: what bytes without frames are (`MavCodec.Sniff`)
  - `{:count, name, n}`: something to count (`MavRouter.Link.Core.Counters`)
  - `{:traced, make}`: what went over the line besides, for the link's recording; `make` gives it as frames
  - `{:written, result}`: the late result of a write, `{:ok, bytes} | {:error, reason}`
  """
  @type event ::
          {:read, [{peer, binary | [MavCodec.Frame.t()]}]}
          | {:records, [{integer, binary}]}
          | {:peer_up, peer, String.t()}
          | {:peer_down, peer, term}
          | {:refused, pos_integer, String.t()}
          | :redirected
          | :passed_on
          | {:closed, term}
          | {:ended | :warning, String.t()}
          | {:sniffed, String.t(), pos_integer, MavCodec.Sniff.t()}
          | {:count, atom, pos_integer}
          | {:traced, (-> [MavCodec.Frame.t()])}
          | {:written, {:ok, non_neg_integer} | {:error, term}}

  @doc "The transport's traits."
  @callback traits() :: traits

  @doc "The forms of its connection strings, the usual one first."
  @callback forms() :: [Form.t(), ...]

  @doc "The fields of `MavRouter.Link.Spec` that a string of one of its forms says; `rest` is what follows the prefix."
  @callback parse(prefix :: String.t(), rest :: String.t()) :: {:ok, map} | {:error, String.t() | :unknown}

  @doc "Reads one of the options that the form names; the error's fields are those of `MavRouter.Link.Spec.Error`."
  @callback option(prefix :: String.t(), name :: String.t(), value :: String.t()) ::
              {:ok, atom, term} | {:error, keyword}

  @doc "Where the link goes, for people; only asked if that is not a host and port."
  @callback place(Spec.t()) :: String.t()

  @doc "Words for a fault that means something particular here, or nil."
  @callback explain(reason :: term, Spec.t()) :: String.t() | nil

  @doc "Opens; runs in a process of its own and may block. `MavRouter.Link.Reason` has words for the reason."
  @callback open(Spec.t()) :: {:ok, conn} | {:error, term}

  @doc "Hands the connection to the link's process; runs in the process that opened it."
  @callback give(conn, link :: pid) :: :ok | {:error, term}

  @doc "Begins to deliver messages to the calling process."
  @callback activate(conn) :: {:ok, conn, info} | {:error, term}

  @doc "Handles a message of the link's mailbox, together with as many more of its own as make a batch."
  @callback handle(conn, message :: term) :: {[event], conn} | :unknown

  @doc "Writes to a peer without blocking."
  @callback write(conn, peer, iodata) :: {:ok, conn} | {:busy, conn} | {:error, term, conn}

  @doc "Ends the connection to a server's peer."
  @callback drop(conn, peer) :: conn

  @doc "Closes."
  @callback close(conn) :: :ok

  @doc """
  Says that the batch was delivered, and how many messages wait at the slowest vehicle; for transports that read only as
  fast as their readers (replay).
  """
  @callback delivered(conn, backlog :: non_neg_integer) :: conn

  @doc "Says that the reads before a `:passed_on` event were delivered by `now` (monotonic ms)."
  @callback passed_on(conn, now :: integer) :: conn

  @doc """
  A value that changes when what a closed link waits for may have come (a device was plugged in): the link then connects
  at once. Compared four times a second while the link is down.
  """
  @callback watch(Spec.t()) :: term

  @doc "Bytes come, but no frames: asks for a `{:sniffed, place, baud, sniffed}` event."
  @callback sniff(conn) :: conn

  @doc """
  The socket and address by which any process may write to a peer past the link's process, or nil. Only where a write is a
  datagram: writes to a stream would mix.
  """
  @callback direct(conn, peer) :: {:udp, :socket.socket(), map} | nil

  @doc "How many datagrams the kernel has dropped since the connection was opened. Called four times a second."
  @callback kernel_dropped(conn) :: non_neg_integer

  @optional_callbacks option: 3,
                      place: 1,
                      explain: 2,
                      kernel_dropped: 1,
                      drop: 2,
                      delivered: 2,
                      passed_on: 2,
                      watch: 1,
                      sniff: 1,
                      direct: 2

  @doc "The transport and the form that a connection string, without its options, belongs to: the longest prefix wins."
  @spec form(String.t()) :: {module, Form.t()}
  def form(body) do
    forms = for transport <- @transports, form <- transport.forms(), do: {transport, form}

    forms
    |> Enum.filter(fn {_transport, form} -> String.starts_with?(body, form.prefix) end)
    |> Enum.max_by(fn {_transport, form} -> byte_size(form.prefix) end)
  end

  @doc "The usual form of each transport, in one line."
  @spec usage() :: String.t()
  def usage, do: Enum.map_join(@transports, ", ", &hd(&1.forms()).expected)

  @doc "All connection strings, each with what it does; for the command line's help and the configuration."
  @spec help() :: [{String.t(), String.t()}]
  def help, do: for(transport <- @transports, form <- transport.forms(), line <- form.help, do: line)

  @doc "All forms of the transports whose `client` trait is this one, in one line."
  @spec usage(:remote | :local) :: String.t()
  def usage(client) do
    for(
      transport <- @transports,
      transport.traits()[:client] == client,
      form <- transport.forms(),
      do: form.expected
    )
    |> Enum.join(", ")
  end
end
