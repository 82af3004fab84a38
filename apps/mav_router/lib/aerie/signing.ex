defmodule Aerie.Signing do
  @moduledoc """
  Signed MAVLink links: keys per network or per vehicle, what is checked of what comes, what is signed of what we send, and
  (`Aerie.Enrolment`) how a flight controller gets its key. How to use it is said by docs/signing.md; how it works, by the README of this
  module's folder.

      Aerie.Signing.list(:default)
      Aerie.Enrolment.enrol(:default, "VID-007")
      Aerie.Signing.vehicle(:default, {"main", 7})

  ## Telemetry

  | event | measurements | metadata besides `gateway` |
  |---|---|---|
  | `[:aerie, :signing, :alarm]` | `rejected` (frames within 10 s) | `link`, `network`, `system`, `component`, `reason` (the most frequent) |
  | `[:aerie, :signing, :enrolled]`, `[:aerie, :signing, :revoked]` | `count` | `network`, `system`, `link`, `by` |
  | `[:aerie, :signing, :failed]` | `count` | and `what` (`:enrolled` or `:revoked`), `reason` |
  | `[:aerie, :signing, :not_stored]` | `count` | `reason`: the time stamps cannot be written (S6) |

  ## Counters

  `{:signing, link, what}` in `Aerie.Store`, in frames: `:verified`, `:unsigned` (taken in without a signature),
  `:rejected`, `:signed` (of ours), `:not_signed` (of ours, MAVLink 1), and `:alarms`.
  """

  alias Aerie.Store
  alias Aerie.Names
  alias Aerie.Secret
  alias Aerie.Signing.{Intake, Scope, Seal, Tables, Vault}
  alias MavCodec.Frame

  @setup_signing 256

  @typedoc "A vehicle's public name, or its key."
  @type vehicle :: String.t() | {network :: String.t(), system :: non_neg_integer}

  @typedoc """
  Bytes that the link's process is to sign: for the system of a network (nil: for all), or with that very key (nil: with
  none). Those of a secret are not shown on their way.
  """
  @type marked ::
          {:sign, {String.t(), non_neg_integer | nil} | Scope.t(), iodata}
          | {:secret, Scope.t() | nil, Secret.t()}

  @typedoc """
  - `policy`, `key`: of the scope that the vehicle belongs to (`main/7`, `main/*`)
  - `state`: `:verified` (the last frame that says something about it was signed rightly), `:unsigned`, `:rejected`
    (nothing of it was taken in yet), `:unknown`
  - `unsafe`: frames are taken in that anybody could have sent; `text` says why, in words for an operator (S11)
  - `verified_at`, `unsigned_at`: unix microseconds or nil; `verified`, `unsigned`, `rejected`: frames
  """
  @type status :: %{
          policy: Scope.policy(),
          key: String.t(),
          state: :verified | :unsigned | :rejected | :unknown,
          unsafe: boolean,
          text: String.t(),
          verified_at: integer | nil,
          unsigned_at: integer | nil,
          verified: non_neg_integer,
          unsigned: non_neg_integer,
          rejected: non_neg_integer
        }

  ## For links and the router

  @doc """
  The frames that are to be taken in, of those that a link received; the others are counted. Whoever forwards frames
  forwards all of them (S10).

  `source` is the router's (`Aerie.Router.source`); its `:trust` (`trust/1`) says what is thought of the link.
  """
  @spec admit(Names.gateway(), map, [Frame.t()]) :: [Frame.t()]
  def admit(gateway, source, frames) do
    case Tables.active(gateway) do
      nil -> frames
      _tables when :erlang.map_get(:trust, source) == :recording -> frames
      tables -> Intake.admit(gateway, tables, source, frames)
    end
  end

  @doc "What is thought of a link: `:secure` when its configuration says so, `:recording` for a file, else `:radio`."
  @spec trust(Aerie.Link.Spec.t()) :: :radio | :secure | :recording
  def trust(%{kind: :replay}), do: :recording
  def trust(%{options: %{secure: true}}), do: :secure
  def trust(_spec), do: :radio

  @doc """
  Marks bytes of our own that go to a system, to be signed by the link's process (`seal/3`), where the order of time stamps
  is that of sending. Without a key for that system they stay as they are.
  """
  @spec mark(Names.gateway(), {String.t(), non_neg_integer | nil}, iodata) :: iodata | marked
  def mark(gateway, key, bytes) do
    if Tables.active(gateway), do: {:sign, key, bytes}, else: bytes
  end

  @doc "The bytes to write to a peer for what a link was given; called in the link's process."
  @spec seal(Names.gateway(), String.t(), term, iodata | marked) :: iodata
  def seal(_gateway, _link, _peer, {:secret, nil, bytes}), do: Secret.reveal(bytes)

  def seal(gateway, link, peer, {:secret, scope, bytes}),
    do: Seal.own(gateway, link, peer, scope, Secret.reveal(bytes))

  def seal(gateway, link, peer, {:sign, key, bytes}), do: Seal.own(gateway, link, peer, key, bytes)
  def seal(_gateway, _link, _peer, bytes), do: bytes

  @doc "What may be recorded of bytes that went out for what a link was given: nothing of a key (S9)."
  @spec shown(iodata | marked, iodata) :: iodata
  def shown({:secret, _key, _secret}, bytes) do
    {frames, _rest} = bytes |> IO.iodata_to_binary() |> Aerie.Wire.frames()
    Enum.map(frames, &MavCodec.Redact.frame(Aerie.Wire.checked(&1)).bytes)
  end

  def shown(_given, bytes), do: bytes

  @doc """
  A client's unsigned frame that is to be signed where a link needs it (`sign: true`, see docs/signing.md); what is signed
  already stays as it is (S10). `fill/4` makes the frame of it.
  """
  @spec placeholder(binary) :: binary
  defdelegate placeholder(bytes), to: Seal

  @doc "Frames as a link writes them to a peer; called in the link's process."
  @spec fill(Names.gateway(), Aerie.Link.Spec.t(), term, iodata) :: iodata
  def fill(gateway, %{id: id, network: network}, peer, frames),
    do: Seal.fill(gateway, id, network, peer, frames)

  @doc "Whether a frame may be forwarded: everything but SETUP_SIGNING, which carries a key (S8)."
  @spec forwardable?(Frame.t()) :: boolean
  def forwardable?(%Frame{id: id}), do: id != @setup_signing

  @doc "A link is no more."
  @spec forget(Names.gateway(), String.t()) :: :ok
  def forget(gateway, link) do
    with tables when is_map(tables) <- Tables.of(gateway), do: Aerie.Signing.Guards.forget(tables, link)
    :ok
  end

  ## For faces

  @doc "What is known of a vehicle's signing; nil when there is no key for it."
  @spec vehicle(Names.gateway(), {String.t(), non_neg_integer}) :: status | nil
  def vehicle(gateway, {_network, _system} = key) do
    with tables when is_map(tables) <- Tables.active(gateway),
         %Scope{} = scope <- Tables.scope(tables, key) do
      status(scope, :ets.lookup(tables.sources, key))
    end
  end

  @doc """
  What is known of a link: `%{secure, unsafe, verified, unsigned, rejected, signed, not_signed, alarms}`; nil when there is
  no key.
  """
  @spec link(Names.gateway(), Aerie.Link.Spec.t()) :: map | nil
  def link(gateway, %{id: id, network: network} = spec) do
    with tables when is_map(tables) <- Tables.active(gateway) do
      unsafe = Enum.any?(scopes(tables), &(elem(&1.id, 0) == network and Scope.unsafe?(&1)))

      [:verified, :unsigned, :rejected, :signed, :not_signed, :alarms]
      |> Map.new(&{&1, Store.counter(gateway, {:signing, id, &1})})
      |> Map.merge(%{secure: trust(spec) == :secure, unsafe: unsafe})
    end
  end

  @doc """
  All keys: `%{key: "main/7", network, system (or :any), policy, source, error, unsafe}`, without the keys themselves;
  `pending`: the vehicles that were sent another key and have not proven to have it; and whether the time stamps could be
  stored.
  """
  @spec list(Names.gateway()) :: %{keys: [map], pending: [String.t()], not_stored: String.t() | nil}
  def list(gateway) do
    case Tables.of(gateway) do
      nil ->
        %{keys: [], pending: [], not_stored: nil}

      tables ->
        keys =
          for %Scope{id: {network, system}} = scope <- Enum.sort_by(scopes(tables), & &1.id) do
            %{
              key: Scope.name(scope.id),
              network: network,
              system: system,
              policy: scope.policy,
              source: scope.source,
              error: scope.error,
              unsafe: Scope.unsafe?(scope)
            }
          end

        pending = for {id, _scope} <- Enum.sort(:ets.tab2list(tables.candidates)), do: Scope.name(id)
        %{keys: keys, pending: pending, not_stored: Tables.setting(tables, :not_stored, nil)}
    end
  end

  defp scopes(tables), do: for({_id, scope} <- :ets.tab2list(tables.scopes), do: scope)

  defp status(scope, found) do
    {verified_at, unsigned_at, verified, unsigned, rejected} =
      case found do
        [{_key, verified_at, unsigned_at, verified, unsigned, rejected}] ->
          {verified_at, unsigned_at, verified, unsigned, rejected}

        [] ->
          {nil, nil, 0, 0, 0}
      end

    state =
      cond do
        verified_at != nil and (unsigned_at == nil or verified_at >= unsigned_at) -> :verified
        unsigned_at != nil -> :unsigned
        rejected > 0 -> :rejected
        true -> :unknown
      end

    %{
      policy: scope.policy,
      key: Scope.name(scope.id),
      state: state,
      unsafe: Scope.unsafe?(scope),
      text: text(scope, state),
      verified_at: verified_at,
      unsigned_at: unsigned_at,
      verified: verified,
      unsigned: unsigned,
      rejected: rejected
    }
  end

  defp text(%{policy: :off}, _state), do: "UNSAFE: signing is off, anybody can send as this vehicle"

  defp text(%{policy: :accept_unsigned}, :verified),
    do: "UNSAFE: signed, but unsigned frames would be taken in too"

  defp text(%{policy: :accept_unsigned}, _state),
    do: "UNSAFE: unsigned frames are taken in, anybody can send as this vehicle"

  defp text(%{error: error}, _state) when error != nil, do: "no signature can be checked: #{error}"
  defp text(_scope, :verified), do: "signed"
  defp text(_scope, :unsigned), do: "unsigned, heard by a link that is marked secure"
  defp text(_scope, :rejected), do: "its frames are refused: no right signature"
  defp text(_scope, :unknown), do: "not heard yet"

  ## Keys

  @doc "Who we are, when that is found out (`Aerie.Router.AutoSystemId`): what has these ids is ours to sign."
  @spec identify(Names.gateway(), {pos_integer, 0..255}) :: :ok
  def identify(gateway, ids) do
    with tables when is_map(tables) <- Tables.of(gateway), do: :ets.insert(tables.settings, {:own, ids})
    :ok
  end

  @doc "Reads the configured keys again, after a file was replaced. What cannot be read leaves the old key in place."
  @spec reload(Names.gateway()) :: [{String.t(), :same | :changed | {:error, String.t()}}]
  def reload(gateway), do: for({id, result} <- Vault.reload(gateway), do: {Scope.name(id), result})
end
