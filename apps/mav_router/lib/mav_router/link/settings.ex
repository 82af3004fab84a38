defmodule MavRouter.Link.Settings do
  @moduledoc """
  The configured links, and what applies to every link unless its own options differ (`MavRouter.Link.Spec`, `options`). The
  settings are kept with the name of the links' supervisor, so that links that are added at run time have them as well.
  """
  use Aerie.Base.Settings

  import Aerie.Base.Settings.Rules

  alias MavRouter.Link.{Spec, Transport}
  alias Aerie.Base.Names
  alias MavRouter.Endpoints.Owner.RuleKeys
  alias Aerie.Base.Settings.Types

  @dialects %{
    all: MavCodec.Dialects.All,
    upstream: MavCodec.Dialects.Upstream,
    ardupilot: MavCodec.Dialects.Ardupilot,
    common: MavCodec.Dialects.Common
  }

  part :identity, MavRouter.Identity.Settings

  section ""

  setting :links,
          {:list, {:section, link_fields()}},
          """
          The connections to vehicles. url is a connection string like those of pymavlink:
            #{strings()}
          id (default: the string), network, label, high_latency, gcs and enabled may be left out. With gcs: allow every program that
          reaches the link may command vehicles, otherwise only programs of this machine; ground stations belong to clients.
          secure: true (or ?secure=true in the url) marks a cable that nobody else can hear: a vehicle may be given its signing
          key there, and its unsigned frames are accepted.
          """,
          default: [],
          example:
            ~S([{id: radio-1, url: "/dev/ttyUSB0,57600", network: main, label: "433 MHz mast", enabled: true}])

  section "mavlink"

  setting :local_addr,
          Types.listen_address(),
          """
          UDP address for vehicles and routers that call the gateway; off for none. Default ":14550", unless links are given.
          """,
          example: ~S(":14550")

  setting :dialects,
          {:list, {:enum, Map.keys(@dialects)}},
          """
          Message definitions to use: all, upstream (PX4), ardupilot, common.
          """,
          default: [:all]

  setting :sysid32, :boolean, "Understand frames with 32-bit system ids (a draft of the standard).",
    default: false

  section "serial",
          "How links with the url serial:auto or serial:DEVICE search. They write nothing while they do."

  setting :serial_ports,
          {:list, :string},
          """
          Ports that are tried before all others, names in /dev or paths; /dev/serial/by-id/*, ttyACM* and ttyUSB* follow. Ports
          of the machine itself (ttyAMA0, ttyTHS1, ttyS0) are tried only if they are named here.
          """,
          key: "ports",
          default: [],
          example: "[/dev/ttyTHS1]"

  setting :serial_bauds,
          {:list, {:integer, 50, 20_000_000}},
          "Baud rates to try, in this order; at most 20.",
          key: "bauds",
          default: MavRouter.Link.Serial.Detector.bauds()

  section "timeouts"

  setting :idle_ms, {:number, 0.1, 86_400}, "A link that hears nothing for this long is idle.",
    key: "link_idle_s",
    default: 10.0,
    times: 1000

  section "limits"

  setting :max_links, {:integer, 1, 10_000}, "Links.", default: 64

  setting :max_peers,
          {:integer, 1, 100_000},
          """
          Peers of one listening link. A known one keeps its place as long as it sends a frame a minute, so that many strangers
          can lock newcomers out: those are refused and counted (peers_refused). Keep strangers off the port, or raise this.
          """,
          default: 1024

  defp link_fields do
    [
      field(:id, Types.token(), "Name of the link; its connection string if left out."),
      field(:url, url(), "Connection string.", required: true),
      field(:network, Types.token(), "System ids are unique within a network."),
      field(:label, :string, "Label for people."),
      field(
        :high_latency,
        :boolean,
        "A satellite link or similar: commands only, no parameters, streams or heartbeats.",
        default: false
      ),
      field(:enabled, :boolean, "Open it.", default: true),
      field(
        :secure,
        :boolean,
        "A cable that nobody else can hear: signing keys may go over it; not if left out."
      ),
      field(
        :gcs,
        {:enum, [:auto, :allow, :deny]},
        """
        Who may command vehicles by this link: auto (if left out), only programs of this machine (loopback); allow, everybody who
        reaches the link; deny, nobody. Ground stations belong to clients.
        """
      ),
      field(
        :parts,
        :boolean,
        """
        Cameras, receivers, modules and companions of the vehicles are on this link: what they measure goes to their
        autopilots, they may ask them, and a companion (component 191 to 194) commands its own vehicle as an operator
        does. Only for a link that nobody else reaches: a sender on it is taken for the part that it says it is.
        """,
        default: false
      ),
      field(
        :group,
        Types.token(),
        "Redundant links to the same vehicles share a group, of which the best one is used."
      ),
      field(
        :carry,
        {:map, :string},
        "For a group: which link carries a class (control, ack, state, transfer, bulk), or all."
      )
    ] ++ RuleKeys.fields()
  end

  @doc "The type of a connection string, as `MavRouter.Link.Spec.parse/2` reads it. The value is the text."
  @spec url() :: Aerie.Base.Settings.Field.type()
  def url do
    {:parse, &parse_url/1, Transport.usage()}
  end

  defp parse_url(text) do
    case Spec.parse(text) do
      # The given text: `spec.text` leaves out what only a server should see.
      {:ok, _spec} ->
        {:ok, String.trim(text)}

      {:error, error} ->
        {:error, Enum.join(["#{error.expected} (#{error.reason})" | List.wrap(error.hint)], "; ")}
    end
  end

  @doc "The options of a link, unless its own ones differ."
  @spec options(t()) :: keyword
  def options(settings) do
    [
      max_peers: settings.max_peers,
      idle_ms: settings.idle_ms,
      parser: parser(settings),
      serial_ports: settings.serial_ports,
      serial_bauds: settings.serial_bauds
    ]
  end

  @doc "The options of a link's parser (`MavCodec.Parser.new/1`)."
  @spec parser(t()) :: [MavCodec.Parser.option()]
  def parser(settings),
    do: [dialects: Enum.map(settings.dialects, &Map.fetch!(@dialects, &1)), sysid32: settings.sysid32]

  @doc "Keeps the settings of a gateway's links; the calling process is their supervisor."
  @spec put(Names.gateway(), t()) :: :ok
  def put(gateway, settings), do: Names.put_value(gateway, :links, settings)

  @doc "`options/1` of a gateway's links; the defaults while their supervisor restarts."
  @spec options_of(Names.gateway()) :: keyword
  def options_of(gateway), do: options(Names.value(gateway, :links) || from(%{}))

  @impl Aerie.Base.Settings
  def problems(%{links: links, limits: limits, serial: serial} = _config) do
    [
      {length(links) > limits.max_links, ["links"], "at most limits.max_links (#{limits.max_links})",
       "#{length(links)}"},
      {length(serial.ports) > 16, ["serial", "ports"], "16 ports at most", "#{length(serial.ports)}"},
      {length(serial.bauds) not in 1..20, ["serial", "bauds"], "1 to 20 baud rates",
       "#{length(serial.bauds)}"}
    ]
    |> failed()
    |> Enum.concat(twice(links, & &1.id, ["links"], "link ids that differ"))
    |> Enum.concat(same_port(links))
    |> Enum.concat(links |> Enum.with_index() |> Enum.flat_map(&link_problems/1))
  end

  # Checks beyond the type of a single key: names of messages and classes.
  defp link_problems({link, index}) do
    exposed =
      with true <- link[:secure], {:error, words} <- Spec.secure(%{link.spec | options: %{secure: true}}) do
        [
          problem(
            ["links", index, "secure"],
            "true for a cable of its own (serial, loopback, one interface)",
            words
          )
        ]
      else
        _fine -> []
      end

    rules = MavRouter.Endpoints.Owner.RuleKeys.wrong(link)
    exposed ++ if(rules, do: [problem(["links", index], "rules that make sense", rules)], else: [])
  end

  defp same_port(links) do
    links
    |> Enum.filter(&(&1.enabled and &1.spec.server and &1.spec.port != 0))
    |> twice(
      &"#{&1.spec.protocol |> to_string() |> String.upcase()} #{Spec.place(&1.spec)}",
      ["links"],
      "addresses to listen on that differ"
    )
  end

  # One a line, with what each does.
  defp strings do
    width = Transport.help() |> Enum.map(fn {string, _does} -> String.length(string) end) |> Enum.max()

    Enum.map_join(Transport.help(), "\n  ", fn {string, does} ->
      String.pad_trailing(string, width + 2) <> does
    end)
  end
end
