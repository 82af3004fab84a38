defmodule Aerie.Link.Egress do
  @moduledoc """
  A link's side of the router: makes each of its peers an endpoint, and writes what the router sends to them.

  A UDP peer without a budget is written to by the sender itself, past this process. Everything else comes here as
  `{:forward, peer, bytes, class}`, is written at once where that is possible, and waits in the peer's
  `Aerie.Router.Outlet` where it is not: a peer that does not read costs the other peers nothing.
  """

  alias Aerie.Link.Spec
  alias Aerie.Names
  alias Aerie.Router.Batch
  alias Aerie.Router.Budget
  alias Aerie.Router.Endpoint
  alias Aerie.Router.Endpoints
  alias Aerie.Router.Outlet
  alias Aerie.Router.Owner
  alias Aerie.Router.Rules
  alias Aerie.Router.Tables
  alias Aerie.Router.Tally

  require Logger

  # A socket without room is tried again after so long.
  @again_ms 10

  @enforce_keys [:gateway, :owner]
  # What was counted for each peer and is added up for the link.
  @sums %{bytes_out: 0, writes_out: 0, dropped_out: 0, denied: 0, withheld: 0}

  defstruct [:gateway, :owner, :baud, :datagrams?, peers: %{}, left: @sums]

  @type t :: %__MODULE__{gateway: Names.gateway(), owner: Owner.t(), peers: %{term => map}}
  @type write :: (term, iodata -> {:ok | :busy | :error, term})

  @doc "The rules of a link, without peers yet. What a former process of the link left is removed."
  @spec open(Names.gateway(), Spec.t()) :: t
  def open(gateway, %Spec{} = spec) do
    rules = spec.options[:router] || []
    # A client that names none sees all.
    own = if rules[:side] == :client, do: [], else: [networks: [spec.network]]
    options = own |> Keyword.merge(rules) |> sparing(spec.options) |> commanding(spec.options)
    tables = Tables.of(gateway)
    owner = Rules.restore(gateway, owner(spec.id, options))

    if tables do
      for endpoint <- Endpoints.of(tables, spec.id), do: Endpoints.remove(tables, endpoint.key)
      Endpoints.put_owner(tables, owner)
    end

    %__MODULE__{
      gateway: gateway,
      owner: owner,
      datagrams?: spec.kind in [:udp_server, :udp_client]
    }
  end

  # A link of high latency carries commands and their answers (X6).
  defp sparing(options, %{high_latency: true}), do: Keyword.put(options, :high_latency, true)
  defp sparing(options, _ordinary), do: options

  # What the connection string says (`?gcs=allow`).
  defp commanding(options, %{gcs: gcs}), do: Keyword.put(options, :gcs, gcs)
  defp commanding(options, _unsaid), do: options

  # Checked where it was configured; a rule that is none is better left out than a link.
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
  Makes endpoints of exactly these peers (`%{peer => text}`). `direct` gives for a peer the socket and address that may be
  written to from any process, or nil.
  """
  @spec sync(t, %{term => String.t()}, (term -> {:udp, term, map} | nil), integer) :: t
  def sync(egress, peers, direct, now) do
    case Tables.of(egress.gateway) do
      nil -> egress
      tables -> sync(egress, tables, peers, direct, now)
    end
  end

  defp sync(egress, tables, peers, direct, now) do
    gone = for {id, _peer} <- egress.peers, not is_map_key(peers, id), do: id
    egress = Enum.reduce(gone, egress, &remove(&2, tables, &1))

    Enum.reduce(peers, egress, fn {id, text}, egress -> join(egress, tables, id, text, direct, now) end)
  end

  @doc "Makes one more peer an endpoint, at a cost that does not depend on how many there are."
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
      %{^id => peer} -> put(told(egress, peer), tables, id, otherwise(peer, out))
      _new -> put(egress, tables, id, peer(egress, tables, id, text, out, now))
    end
  end

  # From now on another process counts what goes there.
  defp otherwise(%{endpoint: endpoint} = peer, out) do
    endpoint = %{endpoint | out: out}
    %{peer | endpoint: endpoint, seen: counts(endpoint)}
  end

  defp peer(egress, tables, id, text, out, now) do
    fields = [text: text, kind: :link, out: out, listens: Endpoints.listens?(tables, egress.owner, :unknown)]

    %{
      endpoint: Endpoint.new(egress.gateway, {egress.owner.id, id}, fields),
      outlet: Outlet.new(rules(egress), now),
      timer: nil,
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
    # The table has what others noted about it meanwhile.
    kept = Endpoints.get(tables, peer.endpoint.key)
    endpoint = if kept, do: %{kept | out: peer.endpoint.out}, else: peer.endpoint
    Endpoints.put(egress.gateway, tables, endpoint)
    %{egress | peers: Map.put(egress.peers, id, %{peer | endpoint: endpoint})}
  end

  @doc """
  The serial line that the link has now, if any: its rate is the budget of those that have none of their own. A USB port
  (ttyACM) has a baud rate in name only.
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

  @doc "Ends a peer's endpoint; what waits for it is forgotten."
  @spec remove(t, term) :: t
  def remove(egress, id) do
    case Tables.of(egress.gateway) do
      nil -> left(egress, id)
      tables -> remove(egress, tables, id)
    end
  end

  defp remove(egress, tables, id) do
    Endpoints.remove(tables, {egress.owner.id, id})
    left(egress, id)
  end

  # What was counted for it since the last time is not lost with it.
  defp left(egress, id) do
    case Map.pop(egress.peers, id) do
      {nil, _peers} -> egress
      {peer, peers} -> told(%{egress | peers: peers}, peer)
    end
  end

  defp told(egress, peer), do: %{egress | left: sum(egress.left, since(peer, counts(peer.endpoint)))}

  defp since(peer, counts), do: Map.merge(counts, peer.seen, fn _name, now, before -> now - before end)
  defp sum(sums, more), do: Map.merge(sums, more, fn _name, a, b -> a + b end)

  @doc "Other rules for the link, while it runs."
  @spec rules(t, Owner.t(), integer) :: t
  def rules(egress, owner, now) do
    egress = %{egress | owner: owner}

    peers =
      Map.new(egress.peers, fn {id, peer} ->
        {outlet, dropped} = Outlet.rules(peer.outlet, rules(egress), now)
        Endpoint.dropped(peer.endpoint, dropped)
        {id, %{peer | outlet: outlet}}
      end)

    %{egress | peers: peers}
  end

  @doc "Frames for a peer. `write` writes to the peer and is given, and gives, the link's state."
  @spec forward(t, term, Aerie.Router.Classify.class(), [binary], integer, write, state) :: {t, state}
        when state: term
  def forward(egress, id, class, frames, now, write, state) do
    case egress.peers do
      %{^id => peer} ->
        Endpoint.taken(peer.endpoint, length(frames))
        {peer, state} = take(peer, class, frames, now, write, state, id)
        {%{egress | peers: %{egress.peers | id => peer}}, state}

      _gone ->
        {egress, state}
    end
  end

  defp take(peer, class, frames, now, write, state, id) do
    with true <- Outlet.free?(peer.outlet),
         {:busy, state} <- write.(state, frames) do
      wait(queue(peer, class, frames, now), @again_ms, id, state)
    else
      {_written_or_lost, state} -> {%{peer | outlet: Outlet.passed(peer.outlet, class, frames, now)}, state}
      false -> drain(queue(peer, class, frames, now), id, now, write, state)
    end
  end

  defp queue(peer, class, frames, now) do
    {outlet, dropped} = Outlet.push(peer.outlet, class, frames, now)
    Endpoint.dropped(peer.endpoint, dropped)
    if outlet.queue.asked.frames > 0, do: Endpoint.asked(peer.endpoint, now)
    %{peer | outlet: outlet}
  end

  @doc "Whether a peer is written to by senders themselves, past the link's process."
  @spec direct?(t, term) :: boolean
  def direct?(egress, id), do: match?(%{^id => %{endpoint: %{out: {:udp, _, _}}}}, egress.peers)

  @doc "It is time to try again: the message `{:pump, peer}` came."
  @spec pump(t, term, integer, write, state) :: {t, state} when state: term
  def pump(egress, id, now, write, state) do
    case egress.peers do
      %{^id => peer} ->
        {peer, state} = drain(%{peer | timer: nil}, id, now, write, state)
        {%{egress | peers: %{egress.peers | id => peer}}, state}

      _gone ->
        {egress, state}
    end
  end

  defp drain(%{timer: timer} = peer, _id, _now, _write, state) when timer != nil, do: {peer, state}

  defp drain(%{outlet: outlet} = peer, id, now, write, state) do
    case Outlet.next(outlet, now) do
      :empty ->
        {peer, state}

      {:wait, ms} ->
        wait(peer, ms, id, state)

      {:send, bytes, rest} ->
        case write.(state, bytes) do
          {:busy, state} -> wait(peer, @again_ms, id, state)
          {_written_or_lost, state} -> drain(%{peer | outlet: rest}, id, now, write, state)
        end
    end
  end

  defp wait(%{timer: nil} = peer, ms, id, state),
    do: {%{peer | timer: Process.send_after(self(), {:pump, id}, ms)}, state}

  defp wait(peer, _ms, _id, state), do: {peer, state}

  @doc "Notes what a peer asks for among frames that it sent: the answers have room of their own (`Aerie.Router.Asked`)."
  @spec asked(t, term, [MavCodec.Frame.t()], integer) :: t
  def asked(egress, id, frames, now) do
    with %{^id => peer} <- egress.peers, {true, outlet} <- Outlet.asked(peer.outlet, frames, now) do
      Endpoint.asked(peer.endpoint, now)
      %{egress | peers: %{egress.peers | id => %{peer | outlet: outlet}}}
    else
      _nothing -> egress
    end
  end

  @doc "Looks for RADIO_STATUS (and ArduPilot's RADIO) among frames that a peer sent, where there is a budget to correct."
  @spec radio(t, term, [MavCodec.Frame.t()]) :: t
  def radio(egress, id, frames) do
    with %{^id => %{outlet: %{budget: %{}}} = peer} <- egress.peers,
         txbuf when txbuf != nil <- Enum.reduce(frames, nil, &txbuf/2) do
      %{egress | peers: %{egress.peers | id => %{peer | outlet: Outlet.radio(peer.outlet, txbuf)}}}
    else
      _nothing -> egress
    end
  end

  defp txbuf(%{id: id, crc_extra: extra, payload: <<_::6-binary, txbuf, _::binary>>}, _last)
       when id in [109, 166] and extra != nil,
       do: txbuf

  defp txbuf(_other, last), do: last

  @doc """
  What was counted for the peers since the last time, by the names of `Aerie.Link.Counters`: written to their sockets by
  others, dropped, refused.
  """
  @spec others(t) :: {%{atom => non_neg_integer}, t}
  def others(egress) do
    Enum.reduce(egress.peers, {egress.left, %{egress | left: @sums}}, fn {id, peer}, {sums, egress} ->
      case counts(peer.endpoint) do
        same when same == peer.seen -> {sums, egress}
        counts -> {sum(sums, since(peer, counts)), put_in(egress.peers[id].seen, counts)}
      end
    end)
  end

  defp counts(%{out: out, tally: tally}) do
    # What goes through the link's process is counted there.
    direct? = match?({:udp, _, _}, out)

    %{
      bytes_out: if(direct?, do: Tally.get(tally, :bytes_out), else: 0),
      writes_out: if(direct?, do: Tally.get(tally, :frames_out), else: 0),
      dropped_out: Tally.lost(tally),
      denied: Tally.get(tally, :denied),
      withheld: Tally.get(tally, :withheld)
    }
  end

  @doc "The link ends: its endpoints go, its rules stay for the next process of the link."
  @spec close(t) :: :ok
  def close(egress) do
    case Tables.of(egress.gateway) do
      nil -> :ok
      tables -> Enum.each(egress.peers, fn {id, _peer} -> Endpoints.remove(tables, {egress.owner.id, id}) end)
    end
  end
end
