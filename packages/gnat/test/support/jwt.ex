defmodule Gnat.Test.Jwt do
  @moduledoc """
  An operator, an account and a user of it, as JWTs signed with nkeys: what `nsc` would make.
  """

  @unlimited %{
    subs: -1,
    data: -1,
    payload: -1,
    imports: -1,
    exports: -1,
    wildcards: true,
    conn: -1,
    leaf: -1
  }

  @doc "`%{config: server configuration, seed: , jwt: , again: }`; `again` makes another JWT of the same user, with other claims."
  def deployment(user_claims \\ %{}) do
    operator = Nkey.generate(:operator)
    account = Nkey.generate(:account)
    user = Nkey.generate(:user)

    operator_jwt = sign(operator, operator.public, "operator", %{})
    account_jwt = sign(operator, account.public, "account", %{limits: @unlimited})

    again = &sign(account, user.public, "user", %{subs: -1, data: -1, payload: -1}, &1)

    config = """
    operator: #{operator_jwt}
    resolver: MEMORY
    resolver_preload: { #{account.public}: #{account_jwt} }
    """

    %{config: config, jwt: again.(user_claims), again: again, seed: Nkey.seed(user)}
  end

  defp sign(signer, subject, type, nats, claims \\ %{}) do
    claims =
      Map.merge(
        %{
          jti: Base.encode32(:crypto.strong_rand_bytes(16), padding: false),
          iat: System.os_time(:second),
          iss: signer.public,
          sub: subject,
          name: type,
          nats: Map.merge(nats, %{type: type, version: 2})
        },
        claims
      )

    content = part(%{typ: "JWT", alg: "ed25519-nkey"}) <> "." <> part(claims)
    content <> "." <> Base.url_encode64(Nkey.sign(signer, content), padding: false)
  end

  defp part(map), do: map |> JSON.encode!() |> Base.url_encode64(padding: false)
end
