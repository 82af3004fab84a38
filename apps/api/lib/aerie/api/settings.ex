defmodule Aerie.Api.Settings do
  @moduledoc "The console, REST, metrics and health; MAVLink over WebSocket; who may use them."
  use Aerie.Base.Settings

  import Aerie.Base.Settings.Rules

  alias Aerie.Base.Secret
  alias Aerie.Api.Settings
  alias Aerie.Base.Settings.Types
  alias Aerie.Access.Keys
  alias Aerie.Access.Users

  section ""

  setting :http, {:section, http_fields()}, "The console, REST, metrics and health on one port."

  setting :console, {:section, console_fields()}, "The console: pages for people, on the port of http."

  setting :api,
          {:section, api_fields()},
          """
          Who may use /api and the WebSocket. Without a key only programs on this machine may, and pages that it serves.
          """

  setting :websocket,
          {:section, websocket_fields()},
          "MAVLink frames over WebSocket, for ground stations in a browser."

  defp http_fields do
    [
      field(:enabled, :boolean, "Serve HTTP at all.", default: true),
      field(
        :address,
        Types.ip(),
        "Address to listen on. Beyond loopback only with a key (api.key or api.keys_file), or a user of the console.",
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
        :proxies,
        {:list, Types.ip()},
        """
        Addresses of your own proxies with TLS in front of this server. Only theirs are X-Forwarded-Proto and X-Forwarded-For believed: cookies
        are then for TLS only, and each client has its own tries to sign in.
        """,
        default: [],
        example: ~S(["127.0.0.1"])
      ),
      field(
        :port,
        {:integer, 0, 65_535},
        """
        Port. Taken: an error if given here, the next free one if not. 0: any free one.
        """,
        default: 4000
      )
    ]
  end

  defp console_fields do
    [
      field(:enabled, :boolean, "Serve it.", default: true),
      field(
        :dir,
        :path,
        "Folder for its users and for the secret that signs their sessions, for its owner only.",
        default: "var/console"
      ),
      field(:max_pages, {:integer, 1, 10_000}, "Open pages at a time; further ones are refused.",
        default: 200
      ),
      %{
        section(:map, "What the map stands on.", Settings.Map.fields())
        | was: %{
            "tiles" => "write map: {layers: [{id: field, file: FILE}]}",
            "tiles_attribution" => "write it as attribution of the layer in map.layers"
          }
      }
    ]
  end

  defp api_fields do
    [
      field(
        :key,
        :secret,
        "The key that goes into the header X-Aerie-Key, 16 characters or more. Better by AERIE_API_KEY than in a file.",
        example: "a-long-random-text"
      ),
      field(
        :keys_file,
        :file,
        """
        File of further keys, one a line, as KEY or NAME KEY, with role=, permissions= and expires= if need be, # for comments;
        KEY may be sha256: and its digest. Only its owner may be able to read it.
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
  end

  defp websocket_fields do
    [
      field(:enabled, :boolean, "Serve it.", default: true),
      field(
        :address,
        Types.ip(),
        "Address to listen on. Beyond loopback only with a key (api); give it TLS there (cert_file).",
        default: "127.0.0.1"
      ),
      field(
        :port,
        {:integer, 0, 65_535},
        "Port. Taken: an error if given here, the next free one if not. 0: any free one.",
        default: 8765
      ),
      field(
        :sign,
        :boolean,
        "What clients with a key that may send do send unsigned is believed, and signed for vehicles that ask for it.",
        default: false
      ),
      field(:max_clients, {:integer, 1, 10_000}, "Clients at a time; further ones are refused.", default: 32),
      field(:cert_file, :file, "Certificate (PEM, with its chain); with it the server speaks wss only.",
        example: ~S("/etc/aerie/gateway.pem")
      ),
      field(:key_file, :file, "The certificate's private key (PEM).", example: ~S("/etc/aerie/gateway.key"))
    ]
  end

  @impl Aerie.Base.Settings
  def problems(%{api: api, http: http, console: console, websocket: websocket}) do
    short? = api.key != nil and byte_size(Secret.reveal(api.key)) < Keys.shortest()
    spaced? = api.key != nil and Secret.reveal(api.key) =~ ~r/\s/u
    keyless? = api.key == nil and api.keys_file == nil

    failed([
      {short?, ["api", "key"], "#{Keys.shortest()} characters or more", "a shorter one"},
      {spaced?, ["api", "key"], "a key without spaces: a header cannot carry them at its ends",
       "one with spaces"},
      {websocket.cert_file == nil != (websocket.key_file == nil), ["websocket"],
       "cert_file and key_file together", "one of them"},
      {http.enabled and keyless? and not local?(http.address) and not users?(console), ["http", "address"],
       "a loopback address as long as there is no key (api.key or api.keys_file) and no user of the console",
       http.address},
      {websocket.enabled and keyless? and not local?(websocket.address), ["websocket", "address"],
       "a loopback address as long as there is no key (api.key or api.keys_file)", websocket.address},
      {websocket.enabled and http.enabled and websocket.port == http.port and websocket.port != 0,
       ["websocket", "port"], "another port than http.port", "#{websocket.port}"}
    ]) ++ Settings.Map.problems(console.map)
  end

  @impl Aerie.Base.Settings
  def warnings(%{http: http, websocket: websocket}) do
    texts([
      {http.enabled and http.proxies == [] and not local?(http.address),
       "http.address is on the network without a proxy with TLS (http.proxies): passwords, keys and sessions can be read on the way."},
      {websocket.enabled and websocket.cert_file == nil and not local?(websocket.address),
       "websocket.address is on the network without websocket.cert_file: keys and frames can be read on the way."}
    ])
  end

  # The users are in a file that the console itself writes.
  defp users?(%{enabled: true, dir: dir}), do: Users.any?(dir)
  defp users?(_off), do: false

  defp local?(address), do: address |> ip() |> Aerie.Base.Net.Address.loopback?()

  @doc "An address of the settings, which was checked."
  @spec ip(String.t()) :: :inet.ip_address()
  def ip(address) do
    {:ok, ip} = :inet.parse_strict_address(String.to_charlist(address))
    ip
  end
end
