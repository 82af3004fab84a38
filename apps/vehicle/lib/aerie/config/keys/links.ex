defmodule Aerie.Config.Keys.Links do
  @moduledoc "The physical ways to vehicles."

  import Aerie.Config.Field, only: [field: 3, field: 4]

  alias Aerie.Config.{Field, Types}
  alias Aerie.Config.Keys.Rules

  @doc "The key `links`."
  @spec field() :: Field.t()
  def field do
    field(
      :links,
      {:list, {:section, fields()}},
      """
      The physical ways to vehicles. url is a connection string as pymavlink has them:
        udpin:HOST:PORT   listen for UDP          udpout:HOST:PORT  send UDP to
        tcpin:HOST:PORT   listen for TCP          tcp:HOST:PORT     connect by TCP
        ws://HOST/PATH    call a WebSocket server, wss:// over TLS (?ca=FILE: its authority)
        DEVICE,BAUD       serial port             replay:FILE.tlog  a recording
        serial:DEVICE     serial port whose baud rate is found by listening
        serial:auto       the first serial port that a vehicle is heard on (see serial)
      id (else the string), network, label, high_latency, gcs and enabled may be left out. gcs: allow lets whoever reaches
      the link command vehicles; else only programs of this machine may, and ground stations belong to clients. secure: true (or
      ?secure=true in the url) marks a cable that nobody else can hear: a vehicle may be given its signing key there, and
      is believed without one.
      """,
      default: [],
      example:
        ~S([{id: radio-1, url: "/dev/ttyUSB0,57600", network: main, label: "433 MHz mast", enabled: true}])
    )
  end

  defp fields do
    [
      field(:id, Types.token(), "Name of the link; its connection string if left out."),
      field(:url, Types.link_url(), "Connection string.", required: true),
      field(:network, Types.token(), "System ids are unique within a network."),
      field(:label, :string, "Words for people."),
      field(
        :high_latency,
        :boolean,
        "A satellite link or the like: commands only, no parameters, streams or heartbeats.",
        default: false
      ),
      field(:enabled, :boolean, "Open it.", default: true),
      field(:secure, :boolean, "A cable that nobody else can hear: signing keys may go over it.",
        default: false
      ),
      field(
        :gcs,
        {:enum, [:auto, :allow, :deny]},
        """
        Whose commands go from this link's ends to vehicles: auto, only those of programs of this machine (loopback);
        allow, those of whoever reaches the link; deny, nobody's. Ground stations belong to clients.
        """,
        default: :auto
      ),
      field(
        :group,
        Types.token(),
        "Redundant links to the same vehicles share a group: the best one carries."
      ),
      field(
        :carry,
        {:map, :string},
        "For a group: the link that carries a class (control, ack, state, transfer, bulk), or all."
      )
    ] ++ Rules.fields()
  end
end
