defmodule Gnat.Auth do
  @moduledoc """
  The credentials in CONNECT.

  No secret is sent to a server that does not ask for it (INFO without `auth_required`), unless the settings say so
  (`auth_required: true`). If several are given, the first of user and password, token, JWT, nkey is used.
  """

  alias Gnat.Error

  @spec options(Gnat.server_info(), Gnat.Settings.t()) :: {:ok, map()} | {:error, Error.t()}
  def options(info, settings) do
    if info[:auth_required] || settings.auth_required, do: credentials(settings, info), else: {:ok, %{}}
  end

  defp credentials(%{username: user, password: password}, _info), do: {:ok, %{user: user, pass: password}}
  defp credentials(%{token: token}, _info), do: {:ok, %{auth_token: token}}

  defp credentials(%{jwt: jwt, nkey_seed: seed}, info) do
    with {:ok, signed} <- sign(seed, info), do: {:ok, %{jwt: jwt, sig: signed.sig}}
  end

  # A bearer JWT needs no signature.
  defp credentials(%{jwt: jwt}, _info), do: {:ok, %{jwt: jwt}}
  defp credentials(%{nkey_seed: seed}, info), do: sign(seed, info)

  # With certificates, or with a default user of the server, none of these is needed.
  defp credentials(_none, _info), do: {:ok, %{}}

  defp sign(seed, info) do
    with {:ok, nonce} <- nonce(info),
         {:ok, nkey} <- nkey(seed) do
      {:ok, %{nkey: nkey.public, sig: nkey |> Nkey.sign(nonce) |> Base.url_encode64(padding: false)}}
    end
  end

  defp nkey(seed),
    do: with({:error, why} <- Nkey.from_seed(seed), do: {:error, Error.new({:credentials, why})})

  defp nonce(%{nonce: nonce}) when is_binary(nonce), do: {:ok, nonce}

  defp nonce(_info),
    do: {:error, Error.new({:credentials, "the server gives no nonce to sign: it knows no nkeys"})}
end
