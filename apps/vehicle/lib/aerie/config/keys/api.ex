defmodule Aerie.Config.Keys.Api do
  @moduledoc "Who may use /api and the WebSocket."

  import Aerie.Config.Field, only: [field: 4, section: 3]

  alias Aerie.Config.{Field, Types}

  @doc "The section `api`."
  @spec section() :: Field.t()
  def section do
    section(
      :api,
      """
      Who may use /api and the WebSocket. Without a key only programs on this machine may, and pages that it serves.
      """,
      [
        field(
          :key,
          :secret,
          "The key that goes into the header X-Aerie-Key, 16 characters or more. Better by AERIE_API_KEY than in a file.",
          example: "a-long-random-text"
        ),
        field(
          :keys_file,
          :path,
          """
          File of further keys, one a line, as KEY or NAME KEY, # for comments; only its owner may be able to read it.
          """,
          example: ~S("/etc/aerie/keys")
        ),
        field(
          :origins,
          {:list, Types.origin()},
          """
          Web pages of other servers that may use /api and the WebSocket, as SCHEME://HOST[:PORT]; they need a key all the same.
          """,
          default: [],
          example: ~S(["https://gcs.example.org"])
        )
      ]
    )
  end
end
