defmodule MavRouter.Signing.Signer do
  @moduledoc """
  Signs frames that go out: our own, and unsigned ones of clients that the gateway signs for (`sign: true`). Runs in the link's
  process, at the moment of writing, because time stamps must go out in their order (S2).

  A frame for one system is signed with the key of that system. A broadcast is signed with each key that its receiver has proven
  within the last minute, one copy for each: usually that is one vehicle, or a radio whose vehicles share a key. Before the receiver
  has proven any, the network's key is used, or without one the keys of its vehicles: a link with keys gets signed frames from the
  first one on.
  """

  alias Aerie.Base.Store
  alias Aerie.Base.Names
  alias MavRouter.Signing.Scope
  alias MavRouter.Signing.Tables
  alias MavRouter.Signing.Verifiers.Verifier
  alias MavRouter.Signing.Verifiers
  alias MavCodec.Frame.Splitter
  alias MavCodec.Frame

  # The size of link id, time stamp and signature.
  @room 13
  @max_peers 8192
  @max_keys 8
  @again_s 10
  @proven_s 60

  @doc "Signs our own bytes for a peer. `key` is as in `t:MavRouter.Signing.marked/0`."
  @spec own(Names.gateway(), String.t(), term, {String.t(), non_neg_integer | nil} | Scope.t(), iodata) ::
          iodata
  def own(gateway, link, peer, key, bytes) do
    with tables when is_map(tables) <- Tables.of(gateway),
         [_ | _] = scopes <- scopes(tables, link, peer, key) do
      # A frame to be signed with one very key is ours, even while our own ids are not known.
      own = if is_struct(key, Scope), do: :any, else: Tables.setting(tables, :own, nil)
      bytes = IO.iodata_to_binary(bytes)
      Enum.map(scopes, &sign(gateway, tables, link, &1, bytes, own))
    else
      _no_key -> bytes
    end
  end

  @doc """
  Marks a frame to be signed: puts as many zeros before it as a signature has bytes, so that it has its final size in queues. A frame
  that is signed already, or cannot be, stays as it is (S10).
  """
  @spec placeholder(binary) :: binary
  def placeholder(<<0xFD, _length, incompat, _::binary>> = bytes) when rem(incompat, 2) == 0,
    do: <<0::size(@room)-unit(8), bytes::binary>>

  def placeholder(bytes), do: bytes

  @doc "Frames as they are written to a peer: marked ones are signed, if there is a key."
  @spec fill(Names.gateway(), String.t(), String.t(), term, iodata) :: iodata
  def fill(gateway, link, network, peer, frames) when is_list(frames) do
    if Enum.any?(frames, &match?(<<0, _::binary>>, &1)),
      do: Enum.map(frames, &filled(&1, gateway, link, network, peer)),
      else: frames
  end

  def fill(_gateway, _link, _network, _peer, bytes), do: bytes

  defp filled(<<0::size(@room)-unit(8), bytes::binary>>, gateway, link, network, peer) do
    with tables when is_map(tables) <- Tables.active(gateway),
         {[frame], ""} <- Splitter.frames(bytes),
         [_ | _] = scopes <- scopes(tables, link, peer, {network, target(frame)}) do
      Enum.map(scopes, &sign(gateway, tables, link, &1, bytes, :any))
    else
      _no_key -> bytes
    end
  end

  defp filled(bytes, _gateway, _link, _network, _peer), do: bytes

  defp target(frame) do
    case Frame.target(frame) do
      {system, _component} when system > 0 -> system
      _everybody -> nil
    end
  end

  defp scopes(_tables, _link, _peer, %Scope{} = scope), do: signing([scope])

  defp scopes(tables, link, peer, {network, nil}) do
    case proven(tables, link, peer) do
      [] -> signing(unproven(tables, network))
      ids -> signing(Enum.map(ids, &:ets.lookup_element(tables.scopes, &1, 2, nil)))
    end
  end

  defp scopes(tables, _link, _peer, key), do: signing([Tables.scope(tables, key)])

  defp unproven(tables, network) do
    case :ets.lookup(tables.scopes, {network, :any}) do
      [{_id, scope}] -> [scope]
      [] -> Enum.take(:ets.select(tables.scopes, [{{{network, :_}, :"$1"}, [], [:"$1"]}]), @max_keys)
    end
  end

  defp signing(scopes),
    do: for(%Scope{policy: policy, error: nil} = s <- scopes, policy != :off, do: s)

  defp sign(gateway, tables, link, scope, bytes, own) do
    signing = Verifiers.get(gateway, tables, link, scope)
    {bytes, signed, unsigned, signing} = Verifier.sign(signing, bytes, own)
    Verifiers.put(tables, link, scope, signing)
    _ = if signed > 0, do: Store.count(gateway, {:signing, link, :signed}, signed)
    _ = if unsigned > 0, do: Store.count(gateway, {:signing, link, :not_signed}, unsigned)
    bytes
  end

  @doc "A peer of a link has proven that it has the key of a scope."
  @spec proved(Tables.t(), String.t(), term, Scope.id()) :: :ok
  def proved(tables, link, peer, scope) do
    now = System.monotonic_time(:second)
    known = :ets.lookup_element(tables.proven, {link, peer}, 2, [])

    case List.keyfind(known, scope, 0) do
      {_scope, at} when now - at < @again_s -> :ok
      _older -> note(tables, {link, peer}, [{scope, now} | List.keydelete(known, scope, 0)], now)
    end
  end

  defp note(tables, key, proven, now) do
    fresh = proven |> Enum.filter(fn {_scope, at} -> now - at < @proven_s end) |> Enum.take(@max_keys)

    if :ets.member(tables.proven, key) or :ets.info(tables.proven, :size) < @max_peers,
      do: :ets.insert(tables.proven, {key, fresh})

    :ok
  end

  defp proven(tables, link, peer) do
    now = System.monotonic_time(:second)

    for {scope, at} <- :ets.lookup_element(tables.proven, {link, peer}, 2, []),
        now - at < @proven_s,
        do: scope
  end
end
