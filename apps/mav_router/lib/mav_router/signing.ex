defmodule MavRouter.Signing do
  @moduledoc """
  Signed MAVLink links: keys per network or per vehicle, verification of received frames, signing of sent ones, and
  (`Aerie.Vehicle.Enrolment`) how a flight controller gets its key. docs/signing.md tells how to use it, the README of this module's folder
  how it works.

      MavRouter.Signing.list(:default)
      Aerie.Vehicle.Enrolment.enrol(:default, "VID-007")
      MavRouter.Signing.vehicle(:default, {"main", 7})

  ## Telemetry

  | event | measurements | metadata besides `gateway` |
  |---|---|---|
  | `[:aerie, :signing, :alarm]` | `rejected` (frames within 10 s) | `link`, `network`, `system`, `component`, `reason` (the most frequent) |
  | `[:aerie, :signing, :enrolled]`, `[:aerie, :signing, :revoked]` | `count` | `network`, `system`, `link`, `by` |
  | `[:aerie, :signing, :failed]` | `count` | and `what` (`:enrolled` or `:revoked`), `reason` |
  | `[:aerie, :signing, :not_stored]` | `count` | `reason`: the time stamps cannot be written (S6) |

  ## Counters

  `{:signing, link, what}` in `Aerie.Base.Store`, in frames: `:verified`, `:unsigned` (taken in without a signature),
  `:rejected`, `:signed` (of ours), `:not_signed` (of ours, MAVLink 1), and `:alarms`.
  """

  alias Aerie.Base.Store
  alias Aerie.Base.Json.Object
  alias Aerie.Base.Names
  alias Aerie.Base.Secret
  alias MavRouter.Signing.{Admission, KeyStore, Scope, Signer, Tables}
  alias MavCodec.Frame

  @typedoc "A vehicle's public id, or its key."
  @type vehicle :: String.t() | {network :: String.t(), system :: non_neg_integer}

  @typedoc """
  Bytes that the link's process is to sign: for the system of a network (nil: for all), or with that very key (nil: with none). Bytes
  in a secret are never shown.
  """
  @type marked ::
          {:sign, {String.t(), non_neg_integer | nil} | Scope.t(), iodata}
          | {:secret, Scope.t() | nil, Secret.t()}

  @typedoc "`fields/0` says what is what. `unsafe`: S11; the times are unix microseconds."
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
  Those of the frames that a link received which are taken in; the others are counted. All of them are forwarded (S10).

  `origin` is `t:MavRouter.Router.origin/0`; its `:trust` says how far the link is trusted (`trust/1`).
  """
  @spec admit(Names.gateway(), map, [Frame.t()]) :: [Frame.t()]
  def admit(gateway, origin, frames) do
    case Tables.active(gateway) do
      nil -> frames
      _tables when :erlang.map_get(:trust, origin) == :recording -> frames
      tables -> Admission.admit(gateway, tables, origin, frames)
    end
  end

  @doc "How far a link is trusted: `:secure` when its configuration says so, `:recording` for a file, else `:radio`."
  @spec trust(MavRouter.Link.Spec.t()) :: :radio | :secure | :recording
  def trust(%{recorded: true}), do: :recording
  def trust(%{options: %{secure: true}}), do: :secure
  def trust(_spec), do: :radio

  @doc """
  Marks our own bytes for a system, to be signed by the link's process (`sign/4`), where the order of time stamps is that of
  sending. Without any key in the gateway they stay as they are.
  """
  @spec mark(Names.gateway(), {String.t(), non_neg_integer | nil}, iodata) :: iodata | marked
  def mark(gateway, key, bytes) do
    if Tables.active(gateway), do: {:sign, key, bytes}, else: bytes
  end

  @doc "The bytes to write to a peer, signed if they are marked; called in the link's process."
  @spec sign(Names.gateway(), String.t(), term, iodata | marked) :: iodata
  def sign(_gateway, _link, _peer, {:secret, nil, bytes}), do: Secret.reveal(bytes)

  def sign(gateway, link, peer, {:secret, scope, bytes}),
    do: Signer.own(gateway, link, peer, scope, Secret.reveal(bytes))

  def sign(gateway, link, peer, {:sign, key, bytes}), do: Signer.own(gateway, link, peer, key, bytes)
  def sign(_gateway, _link, _peer, bytes), do: bytes

  @doc "The part of sent bytes that may be recorded: nothing of a key (S9)."
  @spec without_key(iodata | marked, iodata) :: iodata
  def without_key({:secret, _key, _secret}, bytes) do
    {frames, _rest} = bytes |> IO.iodata_to_binary() |> MavCodec.Frame.Splitter.frames()
    Enum.map(frames, &MavCodec.Signing.Redact.frame(MavCodec.Frame.Splitter.checked(&1)).bytes)
  end

  def without_key(_given, bytes), do: bytes

  @doc """
  Marks a client's unsigned frame, to be signed if the link needs it (`sign: true`, see docs/signing.md); a signed one stays as it is
  (S10). `fill/4` signs it.
  """
  @spec placeholder(binary) :: binary
  defdelegate placeholder(bytes), to: Signer

  @doc "Frames as a link writes them to a peer; called in the link's process."
  @spec fill(Names.gateway(), MavRouter.Link.Spec.t(), term, iodata) :: iodata
  def fill(gateway, %{id: id, network: network}, peer, frames),
    do: Signer.fill(gateway, id, network, peer, frames)

  @doc "Forgets a link that was removed."
  @spec forget(Names.gateway(), String.t()) :: :ok
  def forget(gateway, link) do
    with tables when is_map(tables) <- Tables.of(gateway),
         do: MavRouter.Signing.Verifiers.forget(tables, link)

    :ok
  end

  ## For interfaces

  @fields Object.fields([
            {:policy, :text, nil, "required, accept_unsigned or off"},
            {:key, :text, nil, "name of the key"},
            {:state, {:one_of, [:verified, :unsigned, :rejected, :unknown]}, nil,
             "of the last frame that was taken in, verified or unsigned; rejected: none was yet; unknown: none came"},
            {:unsafe, :boolean, nil, "whether frames are taken in that anybody could have sent"},
            {:text, :text, nil, "the state in words"},
            {:verified_at, :time, nil, "time of the last frame with a valid signature"},
            {:unsigned_at, :time, nil, "time of the last frame without one that was taken in"},
            {:verified, :integer, nil, "frames with a valid signature"},
            {:unsigned, :integer, nil, "frames without one that were taken in"},
            {:rejected, :integer, nil, "frames that were not taken in"}
          ])

  @doc "What is shown of `t:status/0`."
  @spec fields :: [Object.t()]
  def fields, do: @fields

  @doc "The state of a vehicle's signing; nil when there is no key for it."
  @spec vehicle(Names.gateway(), {String.t(), non_neg_integer}) :: status | nil
  def vehicle(gateway, {_network, _system} = key) do
    with tables when is_map(tables) <- Tables.active(gateway),
         %Scope{} = scope <- Tables.scope(tables, key) do
      status(scope, :ets.lookup(tables.sources, key))
    end
  end

  metric = &[metric: "gateway_link_signing_#{&1}_total"]

  @link_fields Object.fields([
                 {:secure, :boolean, nil, "whether the link is one by which keys are given to vehicles"},
                 {:unsafe, :boolean, nil,
                  "whether frames of its network are taken in that anybody could have sent"},
                 {:verified, :integer, nil, "frames received with a valid signature",
                  metric.("verified_frames")},
                 {:unsigned, :integer, nil, "frames accepted without a signature",
                  metric.("unsigned_frames")},
                 {:rejected, :integer, nil, "frames refused because of a wrong or missing signature",
                  metric.("rejected_frames")},
                 {:signed, :integer, nil, "frames that the gateway signed", metric.("signed_frames")},
                 {:not_signed, :integer, nil, "frames that could not be signed: MAVLink 1, or unknown",
                  metric.("not_signed_frames")},
                 {:alarms, :integer, nil, "bursts of refused frames", metric.("alarms")}
               ])

  @doc "What is shown of `link/2`."
  @spec link_fields :: [Object.t()]
  def link_fields, do: @link_fields

  @doc "The state of a link (`link_fields/0`); nil without any key in the gateway."
  @spec link(Names.gateway(), MavRouter.Link.Spec.t()) :: map | nil
  def link(gateway, %{id: id, network: network} = spec) do
    with tables when is_map(tables) <- Tables.active(gateway) do
      unsafe = Enum.any?(scopes(tables), &(elem(&1.id, 0) == network and Scope.unsafe?(&1)))

      [:verified, :unsigned, :rejected, :signed, :not_signed, :alarms]
      |> Map.new(&{&1, Store.counter(gateway, {:signing, id, &1})})
      |> Map.merge(%{secure: trust(spec) == :secure, unsafe: unsafe})
    end
  end

  @doc """
  All keys: `%{key: "main/7", network, system (or :any), policy, source, error, unsafe}`, without the keys themselves; `pending`: the
  vehicles that were sent another key and have not proven yet that they have it; `not_stored`: why the time stamps could not be stored.
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
    do: "UNSAFE: signed, but unsigned frames would be accepted too"

  defp text(%{policy: :accept_unsigned}, _state),
    do: "UNSAFE: unsigned frames are accepted, anybody can send as this vehicle"

  defp text(%{error: error}, _state) when error != nil, do: "no signature can be checked: #{error}"
  defp text(_scope, :verified), do: "signed"
  defp text(_scope, :unsigned), do: "unsigned, heard by a link that is marked secure"
  defp text(_scope, :rejected), do: "its frames are refused: none has a right signature"
  defp text(_scope, :unknown), do: "not heard yet"

  ## Keys

  @doc "The gateway's own ids are found out (`MavRouter.Router.AutoSystemId`): frames with them are ours to sign."
  @spec identify(Names.gateway(), {pos_integer, 0..255}) :: :ok
  def identify(gateway, ids) do
    with tables when is_map(tables) <- Tables.of(gateway), do: :ets.insert(tables.settings, {:own, ids})
    :ok
  end

  @doc "Reads the configured keys again, after a file was replaced. A key that cannot be read leaves the old one in place."
  @spec reload(Names.gateway()) :: [{String.t(), :same | :changed | {:error, String.t()}}]
  def reload(gateway), do: for({id, result} <- KeyStore.reload(gateway), do: {Scope.name(id), result})
end
