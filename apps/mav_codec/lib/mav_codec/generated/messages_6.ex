defmodule MavCodec.Generated.Messages6 do
  use MavCodec.Definition.Shard, messages: {6, 8}
end
