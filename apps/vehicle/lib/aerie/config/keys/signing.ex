defmodule Aerie.Config.Keys.Signing do
  @moduledoc "Signed MAVLink links and their keys."

  import Aerie.Config.Field, only: [field: 3, field: 4, section: 3]

  alias Aerie.Config.{Field, Types}

  @doc "The section `signing`."
  @spec section() :: Field.t()
  def section do
    section(:signing, "Signed MAVLink links.", [
      field(
        :keys,
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
      ),
      field(
        :dir,
        :path,
        "Folder of the time stamps of signed links, and of keys that vehicles were given (keys/, for its owner only).",
        default: "var/signing"
      )
    ])
  end

  defp key_fields do
    [
      field(:network, Types.token(), "Its network."),
      field(:system_id, {:integer, 1, 4_294_967_295}, "Its MAVLink system id."),
      field(:key_file, :path, "File with the key."),
      field(:key_env, :string, "Environment variable with the key."),
      field(:policy, {:enum, [:required, :accept_unsigned, :off]}, "What is asked of frames.",
        default: :required
      ),
      field(:allow_unsigned, {:list, {:integer, 0, 16_777_215}}, "Message ids.", default: [109])
    ]
  end
end
