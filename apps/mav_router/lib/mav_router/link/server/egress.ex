defmodule MavRouter.Link.Server.Egress do
  @moduledoc """
  A link's side of the router: makes each of its peers an endpoint, and writes what the router sends to them.

  Senders write to a UDP peer without a budget themselves, past this process. Everything else comes here as
  `{:forward, peer, frames, class}`. It is written at once if possible, otherwise it waits in the peer's
  `MavRouter.Endpoints.Queue.SendQueue`: a peer that does not read does not slow other peers down.
  """

  alias MavRouter.Link.Spec
  alias MavRouter.Link.Core.Stall
  alias Aerie.Base.Names
  alias MavRouter.Endpoints.Output.Batch
  alias MavRouter.Endpoints.Queue.Budget
  alias MavRouter.Endpoints.Endpoint
  alias MavRouter.Endpoints
  alias MavRouter.Endpoints.Queue.SendQueue
  alias MavRouter.Endpoints.Owner
  alias MavRouter.Endpoints.Owner.SavedRules
  alias MavRouter.Tables
  alias MavRouter.Endpoints.Counters

  require Logger

  # Frames of all peers in the mailbox of the link's process, and what each may have at least.
  @max_waiting 16_384
  @least 64

  # Both have txbuf at the same place.
  @radio [MavCodec.Messages.RadioStatus.id(), MavCodec.Messages.Radio.id()]

  @enforce_keys [:gateway, :owner]
  # Counted for each peer and added up for the link.
  @sums %{bytes_out: 0, writes_out: 0, dropped_out: 0, denied: 0, withheld: 0, routes_refused: 0}

  defstruct [:gateway, :owner, :baud, :datagrams?, peers: %{}, room: nil, gone: @sums]

  @type t :: %__MODULE__{gateway: Names.gateway(), owner: Owner.t(), peers: %{term => map}}
  @typedoc "Writes to the peer; takes and returns the state of the link's process."
  @type write :: (state :: term, iodata -> {:ok | :busy | :error, state :: term})

  @doc "The egress of a link that has no peers yet. Removes what a former process of the link left."
  @spec open(Names.gateway(), Spec.t()) :: t
  def open(gateway, %Spec{} = spec) do
    rules = spec.options[:router] || []
    # A client that names no networks sees all.
    own = if rules[:side] == :client, do: [], else: [networks: [spec.network]]
    options = own |> Keyword.merge(rules) |> high_latency(spec.options) |> gcs(spec.options)
    tables = Tables.of(gateway)
    owner = SavedRules.restore(gateway, owner(spec.id, options))

    if tables do
      for endpoint <- Endpoints.of(tables, spec.id), do: Endpoints.remove(tables, endpoint.key)
      Endpoints.put_owner(tables, owner)
    end

    %__MODULE__{
      gateway: gateway,
      owner: owner,
      datagrams?: spec.protocol == :udp
    }
  end

  # A link of high latency carries commands and their answers (X6).
  defp high_latency(options, %{high_latency: true}), do: Keyword.put(options, :high_latency, true)
  defp high_latency(options, _other), do: options

  # The option of the connection string (`?gcs=allow`).
  defp gcs(options, %{gcs: gcs}), do: Keyword.put(options, :gcs, gcs)
  defp gcs(options, _other), do: options

  # The configuration was checked; if rules are wrong all the same, a link without them is better than none.
  defp owner(id, options) do
    case Owner.new(id, options) do
      {:ok, owner} ->
        owner

      {:error, words} ->
        Logger.error("link #{id}: #{words}")
        {:ok, owner} = Owner.new(id, Keyword.take(options, [:networks, :side]))
        owner
    end
  end

  @doc """
  Makes these peers (`%{peer => text}`), and only them, endpoints. `direct` returns the socket and address to which any process
  may write for a peer, or nil.
  """
  @spec sync(t, %{term => String.t()}, (term -> {:udp, term, map} | nil), integer) :: t
  def sync(egress, peers, direct, now) do
    case Tables.of(egress.gateway) do
      nil -> egress
      tables -> sync(egress, tables, peers, direct, now)
    end
  end

  defp sync(egress, tables, peers, direct, now) do
    former = for {id, _peer} <- egress.peers, not is_map_key(peers, id), do: id
    egress = Enum.reduce(former, egress, &remove(&2, tables, &1))

    Enum.reduce(peers, egress, fn {id, text}, egress -> join(egress, tables, id, text, direct, now) end)
  end

  @doc "Makes one more peer an endpoint; the cost does not depend on how many there are."
  @spec join(t, term, String.t(), (term -> {:udp, term, map} | nil), integer) :: t
  def join(egress, id, text, direct, now) do
    case Tables.of(egress.gateway) do
      nil -> egress
      tables -> join(egress, tables, id, text, direct, now)
    end
  end

  defp join(egress, tables, id, text, direct, now) do
    out = out(egress, id, direct)

    case egress.peers do
      %{^id => %{endpoint: %{out: ^out}}} -> egress
      %{^id => peer} -> put(keep_counts(egress, peer), tables, id, redirect(peer, out))
      _new -> put(egress, tables, id, peer(egress, tables, id, text, out, now))
    end
  end

  # From now on another process counts what is sent to it.
  defp redirect(%{endpoint: endpoint} = peer, out) do
    endpoint = %{endpoint | out: out}
    %{peer | endpoint: endpoint, seen: counts(endpoint)}
  end

  defp peer(egress, tables, id, text, out, now) do
    fields = [text: text, kind: :link, out: out, listens: Endpoints.listens?(tables, egress.owner, :unknown)]

    %{
      endpoint: Endpoint.new(egress.gateway, {egress.owner.id, id}, fields),
      send_queue: SendQueue.new(rules(egress), now),
      timer: nil,
      stall: nil,
      seen: %{}
    }
  end

  defp out(egress, id, direct) do
    if(rules(egress)[:bytes_per_s] == nil, do: direct.(id)) || {:pid, self(), id}
  end

  defp rules(%{owner: owner} = egress) do
    rate = owner.bytes_per_s || (egress.baud && Budget.of_baud(egress.baud))
    [queue: owner.queue, bytes_per_s: rate, chunk: chunk(egress)]
  end

  # Bytes of one write; at least one frame.
  defp chunk(%{datagrams?: false}), do: nil
  defp chunk(%{owner: %{coalesce: true}}), do: Batch.datagram()
  defp chunk(_one_each), do: 1

  defp put(egress, tables, id, peer) do
    # The table has what others noted about the endpoint meanwhile.
    kept = Endpoints.get(tables, peer.endpoint.key)
    endpoint = if kept, do: %{kept | out: peer.endpoint.out}, else: peer.endpoint
    Endpoints.put(egress.gateway, tables, endpoint)
    share(%{egress | peers: Map.put(egress.peers, id, %{peer | endpoint: endpoint})})
  end

  # The room in the mailbox is shared among the peers. It changes when their number has doubled or halved.
  defp share(egress) do
    case room(map_size(egress.peers)) do
      room when room == egress.room ->
        egress

      room ->
        for {_id, %{stall: nil, endpoint: endpoint}} <- egress.peers, do: :ok = Endpoint.limit(endpoint, room)
        %{egress | room: room}
    end
  end

  defp room(peers), do: @max_waiting |> div(Integer.pow(2, length(Integer.digits(peers, 2)))) |> max(@least)

  @doc """
  The device and baud rate of the serial line, if there is one: the rate is the budget of links without one of their own. A
  USB port (ttyACM) has a baud rate in name only.
  """
  @spec line(t, {Path.t() | nil, pos_integer} | nil, integer) :: t
  def line(egress, line, now) do
    case rate(line) do
      baud when baud == egress.baud -> egress
      baud -> rules(%{egress | baud: baud}, egress.owner, now)
    end
  end

  defp rate(nil), do: nil
  defp rate({device, baud}), do: if(usb?(device), do: nil, else: baud)

  defp usb?(nil), do: false

  defp usb?(device) do
    # Names of /dev/serial/by-id are links.
    target = with {:ok, target} <- File.read_link(device), do: target, else: (_ -> device)
    target |> Path.basename() |> String.starts_with?("ttyACM")
  end

  @doc "Removes a peer's endpoint and its queue."
  @spec remove(t, term) :: t
  def remove(egress, id) do
    case Tables.of(egress.gateway) do
      nil -> drop(egress, id)
      tables -> remove(egress, tables, id)
    end
  end

  defp remove(egress, tables, id) do
    Endpoints.remove(tables, {egress.owner.id, id})
    drop(egress, id)
  end

  # Its counts since the last `take_counts/1` are kept.
  defp drop(egress, id) do
    case Map.pop(egress.peers, id) do
      {nil, _peers} -> egress
      {peer, peers} -> share(keep_counts(%{egress | peers: peers}, peer))
    end
  end

  defp keep_counts(egress, peer), do: %{egress | gone: sum(egress.gone, since(peer, counts(peer.endpoint)))}

  defp since(peer, counts), do: Map.merge(counts, peer.seen, fn _name, now, before -> now - before end)
  defp sum(sums, more), do: Map.merge(sums, more, fn _name, a, b -> a + b end)

  @doc "Changes the rules of the running link."
  @spec rules(t, Owner.t(), integer) :: t
  def rules(egress, owner, now) do
    egress = %{egress | owner: owner}

    peers =
      Map.new(egress.peers, fn {id, peer} ->
        {send_queue, dropped} = SendQueue.rules(peer.send_queue, rules(egress), now)
        Endpoint.dropped(peer.endpoint, dropped)
        {id, %{peer | send_queue: send_queue}}
      end)

    %{egress | peers: peers}
  end

  @doc "Sends frames to a peer, or queues them."
  @spec forward(t, term, MavRouter.Endpoints.Queue.TrafficClass.class(), [binary], integer, write, state) ::
          {t, state}
        when state: term
  def forward(egress, id, class, frames, now, write, state) do
    case egress.peers do
      %{^id => peer} ->
        Endpoint.taken(peer.endpoint, length(frames))
        {peer, state} = take({peer, egress.room}, class, frames, now, write, state, id)
        {%{egress | peers: %{egress.peers | id => peer}}, state}

      _gone ->
        {egress, state}
    end
  end

  defp take({peer, room}, class, frames, now, write, state, id) do
    with true <- SendQueue.free?(peer.send_queue),
         {:busy, state} <- write.(state, frames) do
      busy(queue(peer, class, frames, now), id, now, state)
    else
      {_written_or_dropped, state} ->
        {%{peer | send_queue: SendQueue.passed(peer.send_queue, class, frames, now)}, state}

      false ->
        drain(queue(peer, class, frames, now), room, id, now, write, state)
    end
  end

  defp busy(peer, id, now, state) do
    {stall, ms} = Stall.busy(peer.stall, peer.endpoint, now)
    wait(%{peer | stall: stall}, ms, id, state)
  end

  @doc "Whether a peer has taken nothing for so long that its connection is to be ended."
  @spec stuck?(t, term, integer) :: boolean
  def stuck?(egress, id, now) do
    case egress.peers do
      %{^id => %{stall: stall}} -> Stall.stuck?(stall, now)
      _gone -> false
    end
  end

  defp queue(peer, class, frames, now) do
    {send_queue, dropped} = SendQueue.push(peer.send_queue, class, frames, now)
    Endpoint.dropped(peer.endpoint, dropped)
    if send_queue.queue.requested.frames > 0, do: Endpoint.requested(peer.endpoint, now)
    %{peer | send_queue: send_queue}
  end

  @doc "Whether senders write to a peer themselves, past the link's process."
  @spec direct?(t, term) :: boolean
  def direct?(egress, id), do: match?(%{^id => %{endpoint: %{out: {:udp, _, _}}}}, egress.peers)

  @doc "Sends what waits for a peer, when the message `{:pump, peer}` comes."
  @spec pump(t, term, integer, write, state) :: {t, state} when state: term
  def pump(egress, id, now, write, state) do
    case egress.peers do
      %{^id => peer} ->
        {peer, state} = drain(%{peer | timer: nil}, egress.room, id, now, write, state)
        {%{egress | peers: %{egress.peers | id => peer}}, state}

      _gone ->
        {egress, state}
    end
  end

  defp drain(%{timer: timer} = peer, _room, _id, _now, _write, state) when timer != nil, do: {peer, state}

  defp drain(%{send_queue: send_queue} = peer, room, id, now, write, state) do
    case SendQueue.next(send_queue, now) do
      :empty ->
        {peer, state}

      {:wait, ms} ->
        wait(peer, ms, id, state)

      {:send, bytes, rest} ->
        case write.(state, bytes) do
          {:busy, state} ->
            busy(peer, id, now, state)

          {_written_or_dropped, state} ->
            peer = %{peer | send_queue: rest, stall: Stall.took(peer.stall, peer.endpoint, room)}
            drain(peer, room, id, now, write, state)
        end
    end
  end

  defp wait(%{timer: nil} = peer, ms, id, state),
    do: {%{peer | timer: Process.send_after(self(), {:pump, id}, ms)}, state}

  defp wait(peer, _ms, _id, state), do: {peer, state}

  @doc "Notes the requests among frames that a peer sent: the answers have a buffer of their own (`MavRouter.Endpoints.Queue.RequestedData`)."
  @spec note_requests(t, term, [MavCodec.Frame.t()], integer) :: t
  def note_requests(egress, id, frames, now) do
    with %{^id => peer} <- egress.peers,
         {true, send_queue} <- SendQueue.request(peer.send_queue, frames, now) do
      Endpoint.requested(peer.endpoint, now)
      %{egress | peers: %{egress.peers | id => %{peer | send_queue: send_queue}}}
    else
      _nothing -> egress
    end
  end

  @doc "Corrects a peer's budget by the RADIO_STATUS (and ArduPilot's RADIO) among frames that it sent."
  @spec radio(t, term, [MavCodec.Frame.t()], integer) :: t
  def radio(egress, id, frames, now) do
    with %{^id => %{send_queue: %{budget: %{}}} = peer} <- egress.peers,
         txbuf when txbuf != nil <- Enum.reduce(frames, nil, &txbuf/2) do
      send_queue = SendQueue.radio(peer.send_queue, txbuf, now)
      %{egress | peers: %{egress.peers | id => %{peer | send_queue: send_queue}}}
    else
      _nothing -> egress
    end
  end

  defp txbuf(%{id: id, crc_extra: extra, payload: <<_::6-binary, txbuf, _::binary>>}, _last)
       when id in @radio and extra != nil,
       do: txbuf

  defp txbuf(_other, last), do: last

  @doc """
  What was counted for the peers since the last call, by the names of `MavRouter.Link.Core.Counters`: what others wrote
  to their sockets, what was dropped or denied.
  """
  @spec take_counts(t) :: {%{atom => non_neg_integer}, t}
  def take_counts(egress) do
    Enum.reduce(egress.peers, {egress.gone, %{egress | gone: @sums}}, fn {id, peer}, {sums, egress} ->
      case counts(peer.endpoint) do
        same when same == peer.seen -> {sums, egress}
        counts -> {sum(sums, since(peer, counts)), put_in(egress.peers[id].seen, counts)}
      end
    end)
  end

  defp counts(%{out: out, counters: counters}) do
    # The link's process counts what goes through it.
    direct? = match?({:udp, _, _}, out)

    %{
      bytes_out: if(direct?, do: Counters.get(counters, :bytes_out), else: 0),
      writes_out: if(direct?, do: Counters.get(counters, :frames_out), else: 0),
      dropped_out: Counters.lost(counters),
      denied: Counters.get(counters, :denied),
      withheld: Counters.get(counters, :withheld),
      routes_refused: Counters.get(counters, :routes_refused)
    }
  end

  @doc "Removes the endpoints of a link that ends; its rules stay for its next process."
  @spec close(t) :: :ok
  def close(egress) do
    case Tables.of(egress.gateway) do
      nil -> :ok
      tables -> Enum.each(egress.peers, fn {id, _peer} -> Endpoints.remove(tables, {egress.owner.id, id}) end)
    end
  end
end
