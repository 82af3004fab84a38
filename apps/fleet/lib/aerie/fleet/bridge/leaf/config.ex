defmodule Aerie.Fleet.Bridge.Leaf.Config do
  @moduledoc """
  The keys `nats.leaf.*`, which make the embedded nats-server a leaf node of a hub, and what its configuration file says of
  them. Pure.

  The leaf signs in with one secret. nats-server wants an nkey's seed in its configuration, which only its owner can read.
  """

  import Aerie.Base.Settings.Field, only: [field: 4, section: 3]
  import Aerie.Base.Settings.Rules

  alias Aerie.Base.Net.Address
  alias Aerie.Base.Settings.{Field, Schema, Types}

  @port 7422
  @logins [:credentials, :nkey_seed_file]

  @doc "The section `nats.leaf`."
  @spec section() :: Field.t()
  def section do
    section(
      :leaf,
      "Embedded: the hub whose leaf node this server is (docs/fleet.md). Left out, it stands alone.",
      [
        field(
          :url,
          {:one_or_list, Types.nats_url()},
          "The hub's port for leaf nodes, or that of each of its servers.",
          default: [],
          example: ~S("tls://hub.example.org:7422")
        ),
        field(:credentials, :file, "Credentials file (user JWT and nkey seed), for its owner only.",
          example: ~S("/etc/aerie/leaf.creds")
        ),
        field(
          :nkey_seed_file,
          :file,
          "File with an nkey seed (SU…), for its owner only. bin/nats-setup writes one.",
          example: ~S("/etc/aerie/leaf.nk")
        ),
        section(:tls, "TLS to the hub. A tls:// URL means it.", [
          field(
            :ca_file,
            :file,
            "Certificates of the authorities that are trusted (PEM); the system's if left out.",
            example: ~S("/etc/aerie/ca.pem")
          ),
          field(:cert_file, :file, "This server's certificate (PEM), if the hub wants one.",
            example: ~S("/etc/aerie/leaf.pem")
          ),
          field(:key_file, :file, "The certificate's private key (PEM), for its owner only.",
            example: ~S("/etc/aerie/leaf.key")
          )
        ])
      ]
    )
  end

  @doc "Fills in what is left out: the port of each URL."
  @spec derive(map()) :: map()
  def derive(leaf), do: %{leaf | url: Enum.map(leaf.url, &with_port/1)}

  defp with_port(url) do
    uri = URI.parse(url)
    URI.to_string(%{uri | port: uri.port || @port, path: nil, authority: nil})
  end

  @doc "Whether there is a hub."
  @spec on?(map()) :: boolean()
  def on?(%{url: urls}), do: urls != []

  @doc "The files of the section: their keys, what they hold, and whether only their owner may read them."
  @spec files(map()) :: [{key :: String.t(), kind :: atom(), private? :: boolean(), Path.t() | nil}]
  def files(leaf) do
    [
      {"nats.leaf.credentials", :credentials, true, leaf.credentials},
      {"nats.leaf.nkey_seed_file", :nkey_seed, true, leaf.nkey_seed_file},
      {"nats.leaf.tls.ca_file", :certificates, false, leaf.tls.ca_file},
      {"nats.leaf.tls.cert_file", :certificates, false, leaf.tls.cert_file},
      {"nats.leaf.tls.key_file", :private_key, true, leaf.tls.key_file}
    ]
  end

  @doc "Errors of the section; `mode` is `nats.mode`."
  @spec problems(map(), atom()) :: [Schema.problem()]
  def problems(leaf, mode) do
    logins = for key <- @logins, Map.fetch!(leaf, key), do: "nats.leaf.#{key}"
    given = logins ++ for {key, _kind, _private, file} <- files(leaf), file, key not in logins, do: key
    tls? = Enum.any?(leaf.url, &String.starts_with?(&1, "tls://"))

    failed([
      {on?(leaf) and mode != :embedded, ["nats", "leaf", "url"],
       "nats.mode embedded: only a server of our own can be a leaf node", Atom.to_string(mode)},
      {not on?(leaf) and given != [], ["nats", "leaf", "url"],
       "the hub's address beside #{Enum.join(given, ", ")}", "nothing"},
      {match?([_, _ | _], logins), ["nats", "leaf"], "one way to sign in", Enum.join(logins, ", ")},
      {on?(leaf) and logins == [], ["nats", "leaf"],
       "nkey_seed_file or credentials (bin/nats-setup writes them): a hub must not let anybody in",
       "neither"},
      {Enum.any?(leaf.url, &(URI.parse(&1).userinfo != nil)), ["nats", "leaf", "url"],
       "no password in the address: it would be in the logs", "one with a password"},
      {leaf.tls.cert_file == nil != (leaf.tls.key_file == nil), ["nats", "leaf", "tls"],
       "cert_file and key_file together", "one of them"},
      {on?(leaf) and not tls? and Enum.any?(Map.values(leaf.tls)), ["nats", "leaf", "url"],
       "tls:// for nats.leaf.tls", Enum.map_join(leaf.url, ", ", &Address.shown/1)},
      {tls? and Enum.any?(leaf.url, &(not String.starts_with?(&1, "tls://"))), ["nats", "leaf", "url"],
       "tls:// for all of the hub's servers", Enum.map_join(leaf.url, ", ", &Address.shown/1)}
    ])
  end

  @doc "Warnings."
  @spec warnings(map()) :: [String.t()]
  def warnings(leaf) do
    texts([
      {Enum.any?(leaf.url, &(String.starts_with?(&1, "nats://") and not loopback?(&1))),
       "nats.leaf.url is not tls://: anybody on the way to the hub can read and change what is sent."}
    ])
  end

  defp loopback?(url), do: URI.parse(url).host in ["localhost", "127.0.0.1", "::1", "[::1]"]

  @doc "The seed in `nkey_seed_file`, nil without one."
  @spec seed(map()) :: {:ok, String.t() | nil} | {:error, String.t()}
  def seed(%{nkey_seed_file: nil}), do: {:ok, nil}

  def seed(%{nkey_seed_file: file}) do
    with {:ok, text} <- File.read(file), {:ok, %{purpose: :user}} <- Nkey.from_seed(text) do
      {:ok, String.trim(text)}
    else
      {:error, reason} when is_atom(reason) ->
        {:error, "cannot read nats.leaf.nkey_seed_file #{file}: #{:file.format_error(reason)}"}

      _other ->
        {:error, "nats.leaf.nkey_seed_file #{file} has no nkey seed of a user (SU…)"}
    end
  end

  @doc "The block of the server's configuration, empty without a hub."
  @spec render(map(), seed :: String.t() | nil) :: String.t()
  def render(leaf, seed) do
    if on?(leaf) do
      """
      leafnodes {
        reconnect: "1s"
        remotes: [{
          urls: [#{Enum.map_join(leaf.url, ", ", &quoted/1)}]
          #{login(leaf, seed)}
          #{tls(leaf)}
        }]
      }
      """
    else
      ""
    end
  end

  defp login(%{credentials: file}, _seed) when file != nil, do: "credentials: #{quoted(Path.expand(file))}"
  defp login(_leaf, seed), do: "nkey: #{quoted(seed)}"

  defp tls(%{url: ["tls://" <> _ | _], tls: tls}) do
    files = for {key, file} <- Enum.sort(tls), file, do: "#{key}: #{quoted(Path.expand(file))}"
    "tls { #{Enum.join(["timeout: 5" | files], ", ")} }"
  end

  defp tls(_plain), do: ""

  # nats-server reads escapes in quoted strings as JSON does.
  defp quoted(text), do: JSON.encode!(text)
end
