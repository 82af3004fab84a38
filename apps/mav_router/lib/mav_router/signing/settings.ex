defmodule MavRouter.Signing.Settings do
  @moduledoc "Signed MAVLink links and their keys."
  use Aerie.Base.Settings

  import Aerie.Base.Settings.Rules

  alias Aerie.Base.Settings.Types

  part :identity, MavRouter.Identity.Settings

  section "signing", "Signed MAVLink links."

  setting :keys,
          {:list, {:section, key_fields()}},
          """
          One key per vehicle or per network. Each entry names its key by key_file (a file that only its owner can read) or
          key_env (an environment variable): 64 hexadecimal digits, base64 of 32 bytes, or a passphrase. system_id left out
          means every system of the network that has no entry of its own. policy: required (what is not signed rightly is
          refused), accept_unsigned (UNSAFE: what is not signed is taken in) or off. allow_unsigned are message ids that
          need no signature: RADIO_STATUS (109), which radios send themselves.
          """,
          default: [],
          example:
            ~S([{network: main, system_id: 7, key_file: "/etc/aerie/keys/vid-007.key", policy: required}])

  setting :dir,
          :path,
          "Folder of the time stamps of signed links, and of keys that vehicles were given (keys/, for its owner only).",
          default: "var/signing"

  defp key_fields do
    [
      field(:network, Types.token(), "Its network."),
      field(:system_id, {:integer, 1, 4_294_967_295}, "Its MAVLink system id."),
      field(:key_file, :file, "File with the key."),
      field(:key_env, :string, "Environment variable with the key."),
      field(:policy, {:enum, [:required, :accept_unsigned, :off]}, "What is asked of frames.",
        default: struct(MavRouter.Signing.Scope).policy
      ),
      field(:allow_unsigned, {:list, {:integer, 0, 16_777_215}}, "Message ids.",
        default: struct(MavRouter.Signing.Scope).allow
      )
    ]
  end

  @impl Aerie.Base.Settings
  def problems(%{signing: %{keys: keys}}) do
    one_of =
      for {key, index} <- Enum.with_index(keys), key.key_file == nil == (key.key_env == nil) do
        got = if key.key_file, do: "both", else: "neither"
        problem(["signing", "keys", index], "one of key_file and key_env", got)
      end

    one_of ++
      twice(
        keys,
        &"#{&1.network}/#{&1.system_id || "*"}",
        ["signing", "keys"],
        "one key for each network and system id"
      )
  end

  @impl Aerie.Base.Settings
  def warnings(%{signing: %{keys: keys}}) do
    texts([
      {Enum.any?(keys, &(&1.policy != :required)),
       "signing.keys: a policy other than required is UNSAFE: frames that anybody could have sent are taken in."}
    ])
  end
end
