// What the readers of npm find in a recording, as JSON: each message decoded by the schema in the file.
import { open } from "node:fs/promises";
import { McapIndexedReader } from "@mcap/core";
import { FileHandleReadable } from "@mcap/nodejs";
import { loadDecompressHandlers, protobufFromBinaryDescriptor } from "@mcap/support";

const file = await open(process.argv[2]);
const reader = await McapIndexedReader.Initialize({
  readable: new FileHandleReadable(file),
  decompressHandlers: await loadDecompressHandlers(),
});
const topics = {};
const decoders = new Map();
for (const [id, channel] of reader.channelsById) {
  const schema = reader.schemasById.get(channel.schemaId);
  decoders.set(id, protobufFromBinaryDescriptor(schema.data).lookupType(schema.name));
  topics[channel.topic] = { schema: schema.name, messages: 0, sum: 0 };
}
for await (const message of reader.readMessages({ validateCrcs: true })) {
  const topic = topics[reader.channelsById.get(message.channelId).topic];
  const decoded = decoders.get(message.channelId).decode(message.data);
  topic.messages += 1;
  for (const value of Object.values(decoded)) {
    if (typeof value === "number" && Number.isFinite(value)) topic.sum += value;
  }
}
const metadata = [];
for await (const record of reader.readMetadata()) metadata.push([record.name, Object.fromEntries(record.metadata)]);
const attachments = [];
for await (const record of reader.readAttachments()) attachments.push([record.name, record.data.length]);
console.log(JSON.stringify({ topics, metadata, attachments }));
await file.close();
