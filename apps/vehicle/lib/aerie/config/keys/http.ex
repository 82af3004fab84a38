defmodule Aerie.Config.Keys.Http do
  @moduledoc "The console, REST, metrics and health."

  import Aerie.Config.Field, only: [field: 4, section: 3]

  alias Aerie.Config.{Field, Types}

  @doc "The section `http`."
  @spec section() :: Field.t()
  def section do
    section(:http, "The console, REST, metrics and health on one port.", [
      field(:enabled, :boolean, "Serve HTTP at all.", default: true),
      field(
        :address,
        Types.ip(),
        "Address to listen on. Beyond loopback only with a key (api.key or api.keys_file).",
        default: "127.0.0.1"
      ),
      field(
        :hosts,
        {:list, Types.host()},
        """
        Further names by which metrics and health may be asked for. Addresses, localhost and this machine's name are known;
        a request by any other name is refused, because it may be a web page that has its name pointed here.
        """,
        default: [],
        example: ~S(["gateway.example.org"])
      ),
      field(
        :port,
        {:integer, 0, 65_535},
        """
        Port. Taken: an error if given here, the next free one if not. 0: any free one.
        """,
        default: 4000
      )
    ])
  end
end
