defmodule Aerie.Control.Policy.Roles.Sources do
  @moduledoc """
  The senders of commands on interfaces that carry a signature: those whose public nkeys the policy lists. An unknown source
  can command nothing.
  """

  alias Aerie.Control.Policy
  alias Aerie.Control.Policy.Roles
  alias Aerie.Control.Policy.Roles.Signature
  alias Aerie.Vehicle.Command.Refusal

  @typedoc "`nkey` is public (`U…`); `expires` in unix microseconds, nil for never."
  @type listed :: %{
          name: String.t(),
          nkey: String.t(),
          role: Roles.role(),
          permissions: [Aerie.Vehicle.Command.Type.permission()],
          expires: integer() | nil
        }

  @doc """
  The source of a command by its header `Aerie-Signature` (nil: it has none), as `Aerie.Control.Policy.Roles.Signature` describes it. A command
  without a signature comes from nobody, unless the policy has a role for that (`unsigned`).
  """
  @spec identify(
          Policy.t() | nil,
          header :: String.t() | nil,
          subject :: String.t(),
          body :: binary(),
          now :: integer()
        ) ::
          {:ok, Roles.source()} | Refusal.denial()
  def identify(nil, _header, _subject, _body, _now), do: Refusal.deny(:no_policy)
  def identify(%{unsigned: nil}, nil, _subject, _body, _now), do: Refusal.deny(:unsigned)

  def identify(%{unsigned: role}, nil, _subject, _body, _now),
    do: {:ok, Roles.principal(:stranger, "unsigned", role)}

  def identify(policy, header, subject, body, now) do
    with {:ok, key} <- Signature.verify(header, subject, body, now),
         {:ok, listed} <- listed(policy, key, now),
         do: {:ok, Roles.principal(:key, listed.name, listed.role, listed.permissions)}
  end

  @doc "Whether a signed command has an id."
  @spec identified(id :: term()) :: :ok | Refusal.denial()
  def identified(id), do: if(is_binary(id), do: :ok, else: Refusal.deny(:signature_without_id))

  @doc """
  What a request claims to be, before anything is spent on it: by a listed key, without a signature where that may do something, or what is
  refused whatever its body says. A claim proves nothing; `fresh?/2` says whether it is worth the work of checking it.
  """
  @spec claim(Policy.t() | nil, header :: String.t() | nil, now :: integer()) ::
          {:listed, nkey :: String.t()} | :unsigned | :refused
  def claim(nil, _header, _now), do: :refused
  def claim(%{unsigned: nil}, nil, _now), do: :refused
  def claim(_policy, nil, _now), do: :unsigned

  def claim(policy, header, now) do
    with [key, _more] <- String.split(header, " ", parts: 2), {:ok, _listed} <- listed(policy, key, now) do
      {:listed, key}
    else
      _unlisted -> :refused
    end
  end

  @doc "Whether a header is well-formed and its time counts."
  @spec fresh?(header :: String.t(), now :: integer()) :: boolean()
  def fresh?(header, now), do: match?({:ok, _key}, Signature.claim(header, now))

  @doc "The source of a name: who is meant by it where something else than a signature proves it."
  @spec named(Policy.t() | nil, String.t(), now :: integer()) :: {:ok, Roles.source()} | Refusal.denial()
  def named(policy, name, now) do
    listed = Enum.find((policy && policy.sources) || [], &(&1.name == name))

    with {:ok, listed} <- valid(listed, Refusal.deny(:nobody_called, name: name), now),
         do: {:ok, Roles.principal(:key, listed.name, listed.role, listed.permissions)}
  end

  defp listed(policy, key, now) do
    policy.sources
    |> Enum.find(&(&1.nkey == key))
    |> valid(Refusal.deny(:key_unlisted, key: key), now)
  end

  defp valid(nil, unknown, _now), do: unknown

  defp valid(%{expires: expires, name: name}, _unknown, now) when expires != nil and now >= expires,
    do: Refusal.deny(:key_expired, name: name, day: day(expires - 1))

  defp valid(listed, _unknown, _now), do: {:ok, listed}

  defp day(at), do: at |> DateTime.from_unix!(:microsecond) |> DateTime.to_date() |> Date.to_iso8601()
end
