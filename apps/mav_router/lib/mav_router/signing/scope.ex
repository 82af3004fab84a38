defmodule MavRouter.Signing.Scope do
  @moduledoc """
  Whose frames a key is for, and what they must have: one vehicle, or every system of a network that has no key of its own.

  - `:required`: a frame without a right signature is not the vehicle's. It is not taken in, teaches no route, makes no event.
  - `:accept_unsigned`: a wrong signature is refused, a missing one is not. This is unsafe, and shown as such (S11).
  - `:off`: nothing is checked and nothing signed; shown as unsafe too, since there is a key.

  A scope whose key cannot be read fails closed: it refuses everything for which its policy requires a signature.
  """

  alias MavCodec.MessageId
  alias Aerie.Base.Secret
  alias MavRouter.Signing.Key
  alias MavRouter.Signing.KeyStore.KeyFiles

  @radio_status MessageId.of!("RADIO_STATUS")

  @enforce_keys [:id]
  defstruct [:id, :secret, :error, :source, policy: :required, allow: [@radio_status], generation: 0]

  @type id :: {network :: String.t(), system :: non_neg_integer | :any}
  @type policy :: :off | :accept_unsigned | :required

  @typedoc """
  - `id`: the network, and the system or `:any`
  - `secret`: the key, nil when it could not be read; then `error` says why
  - `source`: where it came from, as a text
  - `allow`: message ids that need no signature, RADIO_STATUS unless configured (S7)
  - `generation`: changes with the key, so that links notice
  """
  @type t :: %__MODULE__{
          id: id,
          secret: Secret.t() | nil,
          error: String.t() | nil,
          source: String.t() | nil,
          policy: policy,
          allow: [non_neg_integer],
          generation: integer
        }

  @doc """
  The scopes of a configuration with their keys; those of keys that vehicles were given
  (`MavRouter.Signing.KeyStore.KeyFiles` in `dir`), which take precedence, since the vehicle has that key whatever the
  configuration says; and those of keys that vehicles may have.
  """
  @spec all(MavRouter.Signing.Settings.t(), Path.t() | nil) ::
          {configured :: [t], given :: [t], candidates :: [t]}
  def all(%{keys: keys, identity: identity}, dir) do
    configured = Enum.map(keys, &one(&1, identity.network))

    given =
      for key <- KeyFiles.list(dir, :current), do: given(key, KeyFiles.read(dir, key, :current), configured)

    candidates =
      for key <- KeyFiles.list(dir, :next), do: given(key, KeyFiles.read(dir, key, :next), configured)

    {configured, given, candidates}
  end

  @doc "The scopes in force: those of keys that vehicles were given take precedence."
  @spec in_force([t], [t]) :: [t]
  def in_force(configured, given) do
    ids = Enum.map(given, & &1.id)
    given ++ Enum.reject(configured, &(&1.id in ids))
  end

  @doc "The scope of a key that a vehicle was given, with the policy and exceptions that held for it before."
  @spec given(id, {:ok, Secret.t()} | {:error, String.t()}, [t]) :: t
  def given({network, _system} = id, read, scopes) do
    base =
      Enum.find(scopes, &(&1.id == id)) || Enum.find(scopes, &(&1.id == {network, :any})) ||
        %__MODULE__{id: id}

    base = %{base | id: id, secret: nil, error: nil, source: "enrolment"}

    case read do
      {:ok, secret} -> renewed(%{base | secret: secret})
      {:error, reason} -> renewed(%{base | error: reason})
    end
  end

  defp one(entry, network) do
    {place, source} = source(entry)

    scope = %__MODULE__{
      id: {entry[:network] || network, entry[:system_id] || :any},
      policy: entry[:policy] || struct(__MODULE__).policy,
      allow: entry[:allow_unsigned] || struct(__MODULE__).allow,
      source: place
    }

    case source && Key.read(source) do
      {:ok, secret} -> renewed(%{scope | secret: secret})
      {:error, reason} -> renewed(%{scope | error: reason})
      nil -> renewed(%{scope | error: "neither key_file nor key_env is given"})
    end
  end

  defp source(%{key_file: file}) when is_binary(file), do: {"file #{file}", {:file, file}}
  defp source(%{key_env: name}) when is_binary(name), do: {"environment variable #{name}", {:env, name}}
  defp source(_neither), do: {nil, nil}

  # The scope under a new generation.
  defp renewed(scope), do: %{scope | generation: System.unique_integer()}

  @doc "Whether unsigned frames are taken in although there is a key."
  @spec unsafe?(t) :: boolean
  def unsafe?(%__MODULE__{policy: policy}), do: policy != :required

  @doc "A scope's name: `main/7`, `main/*`."
  @spec name(id) :: String.t()
  def name({network, :any}), do: network <> "/*"
  def name({network, system}), do: "#{network}/#{system}"
end
